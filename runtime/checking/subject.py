"""What the rules check: the text of a machine, from a class or a bundle."""

from __future__ import annotations

import ast
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, Literal, NamedTuple, TypeAlias

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


class Code(NamedTuple):
    """Statements, the name of their machine in them, the names of their module, and parameters."""

    body: Sequence[ast.AST]
    machine: str
    file: str
    names: Mapping[str, Any] = MappingProxyType({})
    parameters: frozenset[str] = frozenset()

    @property
    def truth(self) -> bool | None:
        """What it always returns, if that is True or False."""
        match self.body:
            case [ast.Return(ast.expr() as value)]:
                return truth_of(value)
        return None


def truth_of(condition: ast.expr) -> bool | None:
    """Return True or False if a condition is that always, as ``ready and False`` is; else None."""
    match condition:
        case ast.Constant(bool(value)):
            return value
        case ast.UnaryOp(ast.Not(), operand):
            truth = truth_of(operand)
            return None if truth is None else not truth
        case ast.BoolOp(op, values):
            decides = isinstance(op, ast.Or)
            truths = {truth_of(value) for value in values}
            if decides in truths:
                return decides
            return not decides if truths == {not decides} else None
    return None


class Declared(NamedTuple):
    """A variable or port that the machine itself declares."""

    kind: Literal["variable", "sensor", "actuator"]
    where: Place


class CheckedTransition(NamedTuple):
    """A transition; `always` is True if it fires whenever it is evaluated, False if never."""

    target: str
    where: Place
    always: bool | None
    guard: Code | None = None


class CheckedState(NamedTuple):
    """A state and its transitions in their order."""

    name: str
    where: Place
    transitions: Sequence[CheckedTransition]


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
    methods: dict[str, Code] = field(default_factory=dict)
    sections: list[Code] = field(default_factory=list)
    opaque: bool = False

    def all_code(self) -> Iterator[Code]:
        """Return the machine's code: sections, functions and guards."""
        yield from self.sections
        yield from self.methods.values()
        yield from self.guards()

    def guards(self) -> Iterator[Code]:
        """Return the guards of all transitions."""
        for state in self.states:
            yield from (each.guard for each in state.transitions if each.guard is not None)
