"""All that a machine waits for in a state, found out in the texts of its guards."""

from __future__ import annotations

import ast
from math import floor
from typing import TYPE_CHECKING

from llfsm.runtime.engine.clock import FOREVER
from llfsm.runtime.engine.source_text import syntax_of
from llfsm.runtime.engine.state import SECTIONS, SectionCode, Waiting
from llfsm.runtime.expressions.guards import reads_of_guard

if TYPE_CHECKING:
    from llfsm.runtime.engine.state import State
    from llfsm.runtime.engine.table import Table

_INTERNAL = SECTIONS[2]


def waiting_text(table: Table, state: State) -> str:
    """Write what a machine waits for in a state, or why it is polled."""
    if state.accepting:
        return "is final"
    if any(each.unconditional for each in state.transitions):
        return "goes on at once"
    waiting = waiting_in(table, state)
    if waiting.polls:
        return f"is polled: {waiting.polls}"
    return f"waits for {waiting.text or 'requests'}"


def waiting_in(table: Table, state: State) -> Waiting:
    """Find out what machines with this table wait for in a state, once they have entered it."""
    internal = state.sections.get(_INTERNAL)
    if internal is not None and not _is_empty(internal):
        return Waiting("its Internal")
    sensors: set[str] = set()
    machines: set[str] = set()
    limits_ns: set[float] = set()
    limits_in: set[tuple[str, float]] = set()
    for transition in state.transitions:
        if transition.after_ms is not None:
            limits_ns.add(transition.after_ms * 1_000_000)
        if transition.guard is None:
            continue
        reads = reads_of_guard(transition.guard, table)
        reason = reads.open
        if not reason and reads.reads_time:
            reason = "a limit of time that is computed"
        elif not reason and "" in reads.machines:
            reason = "the status of a machine that is not named"
        if reason:
            return Waiting(f"{reason}, in the guard to {transition.target.name}")
        sensors |= reads.sensors
        machines |= reads.machines
        limits_ns |= reads.limits_ns
        limits_in |= reads.limits_in
    return Waiting(
        "",
        frozenset(sensors),
        frozenset(machines),
        tuple(sorted(floor(min(limit_ns, FOREVER)) for limit_ns in limits_ns)),
        tuple(sorted(limits_in)),
        any(each.ends for each in state.transitions),
    )


def _is_empty(code: SectionCode) -> bool:
    """Check that a section has nothing to run, but ``pass`` or a docstring."""
    node = syntax_of(code)
    return isinstance(node, ast.FunctionDef) and all(
        isinstance(each, ast.Pass)
        or (isinstance(each, ast.Expr) and isinstance(each.value, ast.Constant))
        for each in node.body
    )
