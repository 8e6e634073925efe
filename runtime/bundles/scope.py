"""The names that a machine's code, or a state's, may use, as declarations make them."""

from __future__ import annotations

import ast
from typing import Any, Self

from ..engine.machine import Machine
from ..engine.ports import Actuator, Sensor
from ..engine.table import REQUIRED
from .code import evaluate, parse, run
from .model import Bundle, BundleState, Fragment
from .names import MACHINE, Known, Meaning, resolve, resolve_method

__all__ = ["Scope"]

_CONTROLS = {
    name: Meaning(name, "what every machine has") for name in dir(Machine) if name[0] != "_"
}
_RESERVED = {*dir(Machine), "table"}


class Scope:
    """What is known to a machine's code, or to that of one of its states.

    `variables` and `attributes` are those of the machine class under way, as `define` takes them.
    A state's have its name before theirs, as ``A.count``, so that they cannot clash.
    """

    def __init__(self, module: dict[str, Any]):
        self.module = module
        self.names = dict(_CONTROLS)
        self.variables: dict[str, tuple[Any, Any]] = {}
        self.attributes: dict[str, Any] = {}
        self._prefix = ""

    def of_state(self, state: BundleState) -> Self:
        """Return the scope of a state's code: what it declares hides what the machine does."""
        if not (state.includes or state.variables or state.methods):
            return self
        scope = type(self)(dict(self.module))
        scope.names = dict(self.names)
        scope.variables, scope.attributes = self.variables, self.attributes
        scope._prefix = f"{state.name}."
        scope.declare(state)
        return scope

    @property
    def known(self) -> Known:
        """What a name in the code can mean."""
        return Known(self.names, self.module)

    def declare(self, source: Bundle | BundleState) -> None:
        """Make known what the includes, variables and methods of `source` declare."""
        if source.includes is not None:
            self._include(source.includes)
        if source.variables is not None:
            self._declare_variables(source.variables)
        if source.methods is not None:
            self._declare_methods(source.methods)

    def _include(self, fragment: Fragment) -> None:
        run(parse(fragment), fragment, self.module)
        for name in sorted(self.names.keys() & self.module.keys()):
            raise fragment.error(
                f"{name!r} is {self.names[name].kind}; give what is included another name, as by "
                f"`import ... as`"
            )

    def _declare_variables(self, fragment: Fragment) -> None:
        values = dict(self.module)  # a value may be made from those before it
        for node in _without_docstring(parse(fragment)):
            resolve(node, fragment, Known(_CONTROLS, values), running=False)
            match node:
                case ast.AnnAssign(ast.Name(name), annotation, value):
                    values[name] = self._variable(name, annotation, value, fragment, values)
                    meaning = Meaning(self._prefix + name, "a variable of the machine", True)
                case ast.Assign([ast.Name(name)], value) if not self._prefix:
                    values[name] = self._port(name, value, fragment, values)
                    is_sensor = isinstance(values[name], Sensor)
                    meaning = Meaning(name, "a sensor" if is_sensor else "an actuator")
                case _:
                    also = "" if self._prefix else ", name = Sensor(slot) or name = Actuator(slot)"
                    raise fragment.error(
                        f"here stand only variables, as name: type = value{also}", node.lineno
                    )
            self._name(name, meaning, fragment, node)

    def _variable(
        self,
        name: str,
        annotation: ast.expr,
        value: ast.expr | None,
        fragment: Fragment,
        values: dict[str, Any],
    ) -> Any:
        if value is None and self._prefix:
            raise fragment.error(f"{name!r} needs a value, as {name}: int = 0", annotation.lineno)
        default = REQUIRED if value is None else evaluate(value, fragment, values)
        self.variables[self._prefix + name] = evaluate(annotation, fragment, values), default
        return default

    def _port(
        self, name: str, value: ast.expr, fragment: Fragment, values: dict[str, Any]
    ) -> Sensor[Any, Any] | Actuator[Any]:
        port = evaluate(value, fragment, values)
        if not isinstance(port, Sensor | Actuator):
            raise fragment.error(
                f"{name!r} is no Sensor or Actuator; a variable needs a type, as "
                f"{name}: {type(port).__name__} = {ast.unparse(value)}",
                value.lineno,
            )
        self.attributes[name] = port
        return port

    def _declare_methods(self, fragment: Fragment) -> None:
        functions = []
        for node in _without_docstring(parse(fragment)):
            if isinstance(node, ast.Expr):
                resolve(node, fragment, self.known, running=False)  # the mark of an import
            if not isinstance(node, ast.FunctionDef):
                raise fragment.error(
                    "here stand only functions; imports belong in the includes", node.lineno
                )
            meaning = Meaning(self._prefix + node.name, "a function of the machine")
            self._name(node.name, meaning, fragment, node)
            functions.append(node)
        for function in functions:  # which may call each other, whatever their order
            resolve_method(function, fragment, self.known)
            (function.args.posonlyargs or function.args.args).insert(0, ast.arg(MACHINE))
            made = run(ast.Module([function], []), fragment, self.module, {})
            self.attributes[self._prefix + function.name] = made[function.name]

    def _name(self, name: str, meaning: Meaning, fragment: Fragment, node: ast.stmt) -> None:
        """Let `name` have `meaning`, unless it has one that this would hide from its own code."""
        before = self.names.get(name)
        if name in _RESERVED or name[:2] == "__":
            wrong = "would hide what every machine has; rename it"
        elif before is not None and before.attribute == self._prefix + name:
            wrong = "is declared twice"
        elif name in self.module:
            wrong = "is in the includes already; rename it"
        else:
            self.names[name] = meaning
            return
        raise fragment.error(f"{name!r} {wrong}", node.lineno)


def _without_docstring(tree: ast.Module) -> list[ast.stmt]:
    return tree.body[ast.get_docstring(tree, clean=False) is not None :]
