"""Findings, and the subject of the rules: a machine as its text has it, a class or a bundle."""

from __future__ import annotations

import ast
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Literal, NamedTuple, TypeAlias

from llfsm.runtime.engine.table import Table
from llfsm.runtime.expressions.reads import Code, nodes_of
from llfsm.runtime.expressions.types import Types

Severity: TypeAlias = Literal["error", "warning"]


class Place(NamedTuple):
    """A line of a file; lines count from 1."""

    file: str
    line: int


class Finding(NamedTuple):
    """One error or warning; findings sort by file and line."""

    file: str
    line: int
    severity: Severity
    text: str


class Declared(NamedTuple):
    """A variable or port that the machine itself declares."""

    kind: Literal["variable", "sensor", "actuator"]
    where: Place


class CheckedTransition(NamedTuple):
    """A transition; `always` is True if it fires whenever it is evaluated, False if never.

    It is not evaluated before `after_ms`, if that is given.
    """

    target: str
    where: Place
    always: bool | None
    guard: Code | None = None
    after_ms: float | None = None


class CheckedState(NamedTuple):
    """A state and its transitions in their order; `goes_on` if its Internal is to run again."""

    name: str
    where: Place
    transitions: Sequence[CheckedTransition]
    goes_on: bool = False
    on_entry: Code | None = None


@dataclass
class Subject:
    """A machine as the rules see it; the first state is initial.

    `attributes` are the names that its code may use, or None if they cannot be determined. `opaque`
    is True if some code cannot be read, as it may use anything that is declared.
    """

    states: list[CheckedState]
    suspend: str | None
    attributes: set[str] | None
    declared: dict[str, Declared] = field(default_factory=dict)
    actuators: set[str] = field(default_factory=set)
    sensors: set[str] = field(default_factory=set)
    methods: dict[str, Code] = field(default_factory=dict)
    sections: list[Code] = field(default_factory=list)
    opaque: bool = False

    def all_code(self) -> Iterator[Code]:
        """Yield the machine's code: sections, functions and guards."""
        yield from self.sections
        yield from self.methods.values()
        yield from self.guards()

    def guards(self) -> Iterator[Code]:
        """Yield the guards of all transitions."""
        for state in self.states:
            yield from (each.guard for each in state.transitions if each.guard is not None)


class Piece(NamedTuple):
    """A piece of code, with the types of its expressions, for the rules that need them."""

    code: Code
    types: Types
    table: Table

    @property
    def catches(self) -> bool:
        """True if what is raised in the code may be caught there, as by `with suppress(...)`."""
        kinds = ast.Try | ast.TryStar | ast.With
        return any(isinstance(each, kinds) for each in nodes_of(self.code))

    def finding(self, node: ast.expr | ast.stmt, severity: Severity, text: str) -> Finding:
        """Make a finding at a node; in a bundle, names stand alone."""
        if not self.code.machine.isidentifier():
            text = text.replace(f"{self.code.machine}.", "")
        return Finding(self.code.file, node.lineno, severity, text)
