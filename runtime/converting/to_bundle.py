"""Make a bundle of a machine class, which does the same.

The texts of the class stay as they are, with their comments; only ``self.`` is left out where a
bundle needs none. The structure is the class's table: a loop that declares transitions is not seen.
"""

from __future__ import annotations

import ast
import os
import sysconfig
from dataclasses import replace
from pathlib import Path
from types import FunctionType
from typing import Any

from ..bundles import Bundle, BundleState, BundleTransition, Fragment, compile_bundle
from ..bundles.read import NAME_RULE, STATE_NAME
from ..engine.errors import BundleError, DefinitionError
from ..engine.machine import Machine
from ..engine.source_text import parse_file
from ..engine.state import State, Transition
from .class_files import class_file, class_layout
from .function_text import FunctionTexts, refusal

__all__ = ["class_bundle"]

_OURS = "llfsm"


def class_bundle(cls: type[Machine], folder: Path) -> Bundle:
    """Return the bundle that does what `cls` does; its folder will be in `folder`.

    Raise `BundleError`, with file and line, for what a bundle cannot have.
    """
    return _Converter(cls, folder).bundle()


class _Converter:
    def __init__(self, cls: type[Machine], folder: Path):
        self.cls = cls
        self.table = cls.table
        self.folder = folder
        self.file = class_file(cls)
        self.node = self._statement()
        self.line = self.node.lineno
        if cls.__bases__ != (Machine,):
            bases = ", ".join(base.__name__ for base in cls.__bases__)
            raise self.refused(f"{cls.__name__} inherits from {bases}; a bundle inherits nothing")
        self.methods = {
            node.name: function
            for node in self.node.body
            if isinstance(node, ast.FunctionDef)
            and isinstance(function := vars(cls).get(node.name), FunctionType)
        }
        table = self.table
        names = {*table.variables, *table.sensors, *table.actuators, *self.methods}
        others = {name for name in vars(cls) if name[:2] != "__"} - names
        self.texts = FunctionTexts(names, others, cls)

    def refused(self, what: str, line: int | None = None) -> BundleError:
        return refusal(what, self.file, self.line if line is None else line)

    def _statement(self) -> ast.ClassDef:
        parsed = parse_file(str(self.file))
        for node in parsed[1].body if parsed else ():
            if (
                isinstance(node, ast.ClassDef)
                and node.name == self.cls.__qualname__
                and not (node.decorator_list or node.keywords)
            ):
                return node
        raise refusal(
            f"{self.cls.__qualname__} is not made by a class statement of the module itself",
            self.file,
            None,
        )

    def bundle(self) -> Bundle:
        variables = self._declarations()
        guards = {
            each.guard for state in self.table.states for each in state.transitions if each.guard
        }
        states = tuple(self._state(state) for state in self.table.states)
        methods = [
            self.texts.method(function)
            for name, function in self.methods.items()
            if function not in guards or name in self.texts.called
        ]
        while more := self.texts.called & self.methods.keys() - {*self.texts.written}:
            methods += [self.texts.method(self.methods[name]) for name in sorted(more)]
        doc = ast.get_docstring(self.node)
        described = f'"""{doc}"""\n' if doc and '"' not in doc[-1:] and "\\" not in doc else ""
        includes = "\n".join(filter(None, (described, self.texts.imports.text)))
        bundle = Bundle(
            self.cls.__name__,
            states,
            suspend=self.table.suspend.name if self.table.suspend else None,
            includes=_fragment(includes),
            variables=_fragment(variables),
            methods=_fragment("\n\n".join(methods)),
            include_paths=self._search(),
            layout=class_layout(self.cls),
        )
        try:
            compile_bundle(replace(bundle, folder=self.folder / f"{bundle.name}.machine"))
        except (BundleError, DefinitionError) as error:
            raise self.refused(str(error)) from error
        return bundle

    def _search(self) -> tuple[str, ...]:
        """Return where the bundle finds the class's own module, unless Python knows."""
        package = self.cls.__module__.split(".")
        root = self.file.parents[len(package) - (self.file.stem != "__init__")]
        installed = {Path(sysconfig.get_path(each)) for each in ("stdlib", "purelib", "platlib")}
        if package[0] == _OURS or root in installed:
            return ()
        return (os.path.relpath(root, (self.folder / "x.machine").resolve()),)

    # What the class declares

    def _declarations(self) -> str:
        """Return the variables and ports; refuse what a bundle cannot declare."""
        table, found, lines = self.table, set[str](), []
        for node in self.node.body:
            match node:
                case ast.AnnAssign(ast.Name(name), value=value):
                    if name in table.sensors or name in table.actuators:
                        assert value is not None
                        text = self.texts.declaration(self.file, node, value)
                        lines.append(f"{name} = {text}")
                    elif name in table.variables:
                        lines.append(self.texts.declaration(self.file, node, node))
                    else:
                        what = f"{name!r} is a constant of the class; put it into the module"
                        raise self.refused(what, node.lineno)
                    found.add(name)
                case ast.Assign([ast.Name(name)]):
                    if name in table.sensors or name in table.actuators:
                        lines.append(self.texts.declaration(self.file, node, node))
                        found.add(name)
                    elif not isinstance(vars(self.cls).get(name), State):
                        self._check_gone(name, node.lineno)
                case ast.FunctionDef(name) | ast.ClassDef(name):
                    if name not in self.methods:
                        self._check_gone(name, node.lineno)
        missing = {*table.variables, *table.sensors, *table.actuators} - found
        if missing:
            raise self.refused(f"{min(missing)!r} is not declared by a statement of its own")
        return "".join(f"{line}\n" for line in lines)

    def _check_gone(self, name: str, line: int) -> None:
        if name in vars(self.cls) and name[:2] != "__":
            what = "neither a variable with a type, a port, a state nor a plain function"
            raise self.refused(f"{name!r} is {what}, which are all that a bundle has", line)

    # What states do

    def _state(self, state: State) -> BundleState:
        if not STATE_NAME.fullmatch(state.name):
            raise self.refused(f"{state.name!r} cannot name a state there: {NAME_RULE}")
        sections = {
            section: Fragment(self.texts.section(code, f"{section} of {state.name}", self.line))
            for section, code in state.sections.items()
        }
        transitions = tuple(self._transition(each) for each in state.transitions)
        return BundleState(state.name, sections, transitions)

    def _transition(self, transition: Transition) -> BundleTransition:
        parts = [transition.timed] if transition.timed else []
        if transition.guard is not None:
            what = f"the guard from {transition.source.name} to {transition.target.name}"
            parts.append(self._guard(transition.guard, what, is_alone=not parts))
        text = " and ".join(parts)
        return BundleTransition(transition.target.name, Fragment(f"{text}\n") if text else None)

    def _guard(self, guard: Any, what: str, *, is_alone: bool) -> str:
        text = self.texts.expression(guard, what, self.line, is_alone=is_alone)
        if text is not None:
            return text
        for name, method in self.methods.items():
            if method is guard:
                self.texts.called.add(name)
                return f"{name}()"
        raise self.refused(
            f"{what} has several statements; give the function a name in the class, other than _",
            guard.__code__.co_firstlineno,
        )


def _fragment(text: str) -> Fragment | None:
    return Fragment(text) if text.strip() else None
