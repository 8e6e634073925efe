"""The names that a machine's code, or a state's, may use: the rules of what declares them."""

from __future__ import annotations

import ast
from abc import ABC, abstractmethod
from collections.abc import Container
from typing import Any, Self

from ..engine.errors import BundleError
from ..engine.machine import Machine
from ..engine.ports import Actuator, Sensor
from ..engine.table import REQUIRED
from .code import evaluate, parse, run
from .model import Bundle, BundleState, Fragment
from .names import MACHINE, Known, Meaning, is_mark, resolve, resolve_method, untranslated

__all__ = ["CONTROLS", "LoadedScope", "Scope"]

CONTROLS = {
    name: Meaning(name, "what every machine has") for name in dir(Machine) if name[0] != "_"
}
"""The names that are known to the code of every machine."""
_RESERVED = {*dir(Machine), "table"}


class Scope(ABC):
    """What is known to a machine's code, or to that of one of its states.

    This holds the rules of what may be declared, and under which names. A subclass decides what a
    declaration does, and what to do when one is wrong. `prefix` stands before the names that a
    state declares, as in ``A.count``, so that states' names cannot clash.
    """

    def __init__(self, included: Container[str], *, within: Scope | None = None, prefix: str = ""):
        self.included = included
        self.names: dict[str, Meaning] = dict(CONTROLS if within is None else within.names)
        self.prefix = prefix

    # What a subclass does

    def wrong(self, error: BundleError) -> None:
        """Take note of an error; raise it to stop."""
        raise error

    def statements(self, fragment: Fragment) -> list[ast.stmt]:
        """Return the statements of a text that declares."""
        tree = parse(fragment)
        return tree.body[ast.get_docstring(tree, clean=False) is not None :]

    @abstractmethod
    def include(self, fragment: Fragment) -> set[str]:
        """Take over the names of an include and return them."""

    @abstractmethod
    def variable(self, name: str, node: ast.AnnAssign, fragment: Fragment) -> None:
        """Take over a declared variable."""

    @abstractmethod
    def port(self, name: str, node: ast.Assign, fragment: Fragment) -> str:
        """Take over a declared port and return what to call its kind."""

    @abstractmethod
    def function(self, node: ast.FunctionDef, fragment: Fragment) -> None:
        """Take over a function of the machine; all of them have their names by now."""

    # The rules

    def declare(self, source: Bundle | BundleState) -> None:
        """Declare what the includes, variables and methods of `source` declare."""
        if source.includes is not None:
            for name in sorted(self.names.keys() & self.include(source.includes)):
                self.wrong(source.includes.error(
                    f"{name!r} is {self.names[name].kind}; give what is included another name, as "
                    f"by `import ... as`"
                ))  # fmt: skip
        if source.variables is not None:
            for node in self.statements(source.variables):
                self._declare_variable(node, source.variables)
        if source.methods is not None:
            functions = []
            for node in self.statements(source.methods):
                if isinstance(node, ast.FunctionDef):
                    functions.append(node)
                    if self._is_free(node.name, source.methods, node):
                        attribute = self.prefix + node.name
                        self.names[node.name] = Meaning(attribute, "a function of the machine")
                else:
                    what = "only functions can be declared here; imports belong in the includes"
                    self._refuse(node, source.methods, what)
            for function in functions:  # which may call each other, whatever their order
                self.function(function, source.methods)

    def _declare_variable(self, node: ast.stmt, fragment: Fragment) -> None:
        match node:
            case ast.AnnAssign(ast.Name(name)):
                if self._is_free(name, fragment, node):
                    self.variable(name, node, fragment)
                    attribute = self.prefix + name
                    self.names[name] = Meaning(attribute, "a variable of the machine", True)
            case ast.Assign([ast.Name(name)]) if not self.prefix:
                if self._is_free(name, fragment, node):
                    self.names[name] = Meaning(name, self.port(name, node, fragment))
            case _:
                also = "" if self.prefix else ", name = Sensor(slot) or name = Actuator(slot)"
                what = f"only variables can be declared here, as name: type = value{also}"
                self._refuse(node, fragment, what)

    def _refuse(self, node: ast.stmt, fragment: Fragment, what: str) -> None:
        self.wrong(
            untranslated(fragment, node) if is_mark(node) else fragment.error(what, node.lineno)
        )

    def _is_free(self, name: str, fragment: Fragment, node: ast.stmt) -> bool:
        """Return whether a declaration may use `name`, and would not hide it from its own code."""
        before = self.names.get(name)
        if name in _RESERVED or name[:2] == "__":
            what = "would hide what every machine has; rename it"
        elif before is not None and before.attribute == self.prefix + name:
            what = "is declared twice"
        elif name in self.included:
            what = "is in the includes already; rename it"
        else:
            return True
        self.wrong(fragment.error(f"{name!r} {what}", node.lineno))
        return False


class LoadedScope(Scope):
    """A scope whose declarations are executed.

    `variables` and `attributes` are those of the machine class under way, as `define` takes them.
    """

    def __init__(
        self, module: dict[str, Any], *, within: LoadedScope | None = None, prefix: str = ""
    ):
        super().__init__(module, within=within, prefix=prefix)
        self.module = module
        self.variables: dict[str, tuple[Any, Any]] = {} if within is None else within.variables
        self.attributes: dict[str, Any] = {} if within is None else within.attributes
        self._values: dict[str, Any] = {}  # of the variables so far, which later ones may use

    def of_state(self, state: BundleState) -> Self:
        """Return the scope of a state's code: what it declares hides what the machine does."""
        if not (state.includes or state.variables or state.methods):
            return self
        scope = type(self)(dict(self.module), within=self, prefix=f"{state.name}.")
        scope.declare(state)
        return scope

    @property
    def known(self) -> Known:
        """What a name in the code can mean."""
        return Known(self.names, self.module)

    def include(self, fragment: Fragment) -> set[str]:
        """Run an include."""
        return {*run(parse(fragment), fragment, self.module)}

    def variable(self, name: str, node: ast.AnnAssign, fragment: Fragment) -> None:
        """Evaluate a variable's type and value."""
        values = self._resolved(node, fragment)
        if node.value is None and self.prefix:
            raise fragment.error(f"{name!r} needs a value, as {name}: int = 0", node.lineno)
        default = REQUIRED if node.value is None else evaluate(node.value, fragment, values)
        annotation = evaluate(node.annotation, fragment, values)
        self.variables[self.prefix + name] = annotation, default
        self._values[name] = default

    def port(self, name: str, node: ast.Assign, fragment: Fragment) -> str:
        """Make a port."""
        port = evaluate(node.value, fragment, self._resolved(node, fragment))
        if not isinstance(port, Sensor | Actuator):
            raise fragment.error(
                f"{name!r} is not a Sensor or an Actuator; a variable needs a type, as "
                f"{name}: {type(port).__name__} = {ast.unparse(node.value)}",
                node.lineno,
            )
        self.attributes[name] = self._values[name] = port
        return "a sensor" if isinstance(port, Sensor) else "an actuator"

    def function(self, node: ast.FunctionDef, fragment: Fragment) -> None:
        """Make a method, with a hidden parameter for its machine."""
        resolve_method(node, fragment, self.known)
        (node.args.posonlyargs or node.args.args).insert(0, ast.arg(MACHINE))
        made = run(ast.Module([node], []), fragment, self.module, {})
        self.attributes[self.prefix + node.name] = made[node.name]

    def _resolved(self, node: ast.stmt, fragment: Fragment) -> dict[str, Any]:
        """Return what a declaration may name, having checked that it names nothing else."""
        values = self.module | self._values
        resolve(node, fragment, Known(CONTROLS, values), running=False)
        return values
