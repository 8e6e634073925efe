"""A machine class as a subject of the rules; its code is found in its source files."""

from __future__ import annotations

import ast
import sys
from collections.abc import Callable, Iterator
from inspect import isfunction
from types import FunctionType
from typing import Any

from llfsm.errors import nothing_called
from llfsm.runtime.checking._inner_rules import inner_findings
from llfsm.runtime.checking._rules import findings_of
from llfsm.runtime.checking._subject import (
    CheckedState,
    CheckedTransition,
    Declared,
    Finding,
    Place,
    Subject,
)
from llfsm.runtime.checking._typed_rules import signature_of, typed_findings
from llfsm.runtime.engine.machine import Machine
from llfsm.runtime.engine.source_text import parse_file, syntax_of
from llfsm.runtime.engine.state import State, Transition
from llfsm.runtime.expressions.reads import Code, parameter_names, unbound_names


def check_class(cls: type[Machine]) -> list[Finding]:
    """Check `cls`, whose code is read but not called; return what is found.

    Only what the class itself declares can be unused: other classes may use what it inherits.
    """
    reader = _Reader(cls)
    subject = reader.subject()
    found = {*findings_of(subject), *typed_findings(subject, cls.table), *reader.findings}
    return sorted(found | {*inner_findings(cls, reader.place_of, reader.functions())})


def class_subject(cls: type[Machine]) -> Subject:
    """Read `cls` as the subject of rules."""
    return _Reader(cls).subject()


class _Reader:
    def __init__(self, cls: type[Machine]):
        self.cls = cls
        self.table = cls.table
        self.opaque = False
        self.findings: list[Finding] = []
        self.file = getattr(sys.modules.get(cls.__module__), "__file__", None) or "<unknown>"
        self.definition = _class_definition(self.file, cls.__qualname__)
        self.line = self.definition.lineno if self.definition else 1

    def subject(self) -> Subject:
        table = self.table
        methods: dict[str, Code] = {}
        sections: list[Code] = []
        for name, function in self.functions():
            if code := self.code(function):
                sections += [methods[name]] if name in methods else []  # still there for super()
                methods[name] = code
        for state in table.states:
            for each in state.sections.values():
                self.expect_only_machine(each, "a section")
                sections += [code] if (code := self.code(each)) else []
            for each in filter(isfunction, state.runs):  # what makes the machines that it runs
                sections += [code] if (code := self.code(each)) else []
        return Subject(
            [self.state(state) for state in table.states],
            table.suspend.name if table.suspend else None,
            self.attributes(),
            dict(self.declared()),
            set(table.actuators),
            set(table.sensors),
            methods,
            sections,
            self.opaque,
        )

    def functions(self) -> Iterator[tuple[str, Callable[..., Any]]]:
        for owner in reversed(self.cls.__mro__):
            if owner in Machine.__mro__:
                continue
            for name, value in vars(owner).items():
                if name == "__annotate_func__":  # which Python 3.14 makes of the annotations
                    continue
                if isinstance(value, property) and value.fget:
                    yield name, value.fget
                elif isinstance(value, FunctionType):
                    yield name, value

    def attributes(self) -> set[str] | None:
        if hasattr(self.cls, "__getattr__"):
            return None
        return {*dir(self.cls), *self.table.variables}

    def declared(self) -> Iterator[tuple[str, Declared]]:
        table = self.table
        for name, variable in table.variables.items():
            if variable.owner is self.cls:
                yield name, Declared("variable", self.place(name))
        for name in table.sensors.keys() & vars(self.cls).keys():
            yield name, Declared("sensor", self.place(name))
        for name in table.actuators.keys() & vars(self.cls).keys():
            if table.actuators[name].at_end is None:  # that alone is a use
                yield name, Declared("actuator", self.place(name))

    def state(self, state: State) -> CheckedState:
        transitions = [self.transition(each) for each in state.transitions]
        place = self.place_of(state)
        goes_on = state.final and "Internal" in state.sections
        entry = state.sections.get("OnEntry")
        on_entry = None if entry is None else self.code(entry)
        return CheckedState(state.name, place, transitions, goes_on, on_entry)

    def place_of(self, state: State) -> Place:
        called = (name for name, value in vars(self.cls).items() if value is state)
        return self.place(next(called, ""))

    def transition(self, transition: Transition) -> CheckedTransition:
        if transition.guard is not None:
            self.expect_only_machine(transition.guard, "a guard")
        guard = None if transition.guard is None else self.code(transition.guard)
        always = transition.unconditional or (guard.truth if guard else None)
        if guard and always and transition.after_ms is not None:
            always = None  # not before that time
        place = Place(*transition.location)
        return CheckedTransition(transition.target.name, place, always, guard, transition.after_ms)

    def expect_only_machine(self, function: Callable[..., Any], what: str) -> None:
        """Find functions that cannot be called with the machine alone."""
        if isinstance(function, FunctionType):
            try:
                signature_of(function).bind(None)
            except TypeError:
                place = function.__code__.co_filename, function.__code__.co_firstlineno
                text = f"{what} is called with the machine alone: its only parameter is self"
                self.findings.append(Finding(*place, "error", text))

    def code(self, function: Callable[..., Any]) -> Code | None:
        """Read a function; None, and the class is opaque, if its text cannot be read."""
        node = syntax_of(function)
        arguments = [*node.args.posonlyargs, *node.args.args] if node else []
        if not (node and arguments):
            self.opaque = True
            return None
        body = node.body if isinstance(node.body, list) else [_returned(node.body)]
        file = function.__code__.co_filename
        for name, line in unbound_names(function):
            text = nothing_called(name, {*function.__globals__, *sys.stdlib_module_names})
            if name in function.__globals__:
                text = f"{name!r} has no value here, as the code changes it: declare a variable"
            elif name in (self.attributes() or ()):
                text = f"nothing is called {name!r}; did you mean {arguments[0].arg}.{name}?"
            self.findings.append(Finding(file, line, "error", text))
        parameters = parameter_names(node.args)
        return Code(body, arguments[0].arg, file, function.__globals__, parameters)

    def place(self, name: str) -> Place:
        """Find where the class gives `name` its meaning, or else where the class begins."""
        for node in self.definition.body if self.definition else ():
            match node:
                case ast.AnnAssign(ast.Name(found)) | ast.Assign([ast.Name(found)]):
                    if found == name:
                        return Place(self.file, node.lineno)
        return Place(self.file, self.line)


def _returned(value: ast.expr) -> ast.Return:
    return ast.copy_location(ast.Return(value), value)


def _class_definition(file: str, qualname: str) -> ast.ClassDef | None:
    parsed = parse_file(file)
    found: ast.AST | None = parsed and parsed[1]
    for name in qualname.split("."):
        if name != "<locals>":
            found = next(
                (node for node in ast.walk(found) if _is_named(node, name)) if found else iter(()),
                None,
            )
    return found if isinstance(found, ast.ClassDef) else None


def _is_named(node: ast.AST, name: str) -> bool:
    return isinstance(node, ast.ClassDef | ast.FunctionDef) and node.name == name
