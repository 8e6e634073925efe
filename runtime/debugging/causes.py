"""Why a machine is still in its state: each transition's value, and the operands it has seen."""

from __future__ import annotations

import ast
from collections.abc import Mapping
from contextlib import suppress
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from llfsm.runtime.engine.source_text import EXPRESSION

from .operands import Operands, parsed
from .seen_text import elapsed_text, seen_text

if TYPE_CHECKING:
    from llfsm.runtime.engine.machine import Machine
    from llfsm.runtime.engine.state import Transition

    from .last_turns import LastTurn

__all__ = ["NOT_EVALUATED", "Cause", "fired", "seen_in", "why"]

NOT_EVALUATED: Final = "not evaluated"
"""What stands for the operands of a transition after the one that has fired, or has raised."""


class Cause(NamedTuple):
    """A transition: its value, None if it is not known or was not evaluated."""

    target: str
    label: str
    value: bool | None
    seen: str
    """The expression with the values of its parts."""


def why(machine: Machine, state: str, elapsed_ns: int | None) -> list[Cause]:
    """Return the transitions of a state in their order, as they would be evaluated now.

    `elapsed_ns` is for how long the machine has been in the state; None if it has not entered it.
    Nothing is called that has an effect.
    """
    transitions = _transitions(machine, state)
    return [_cause(machine, state, each, elapsed_ns, {}) for each in transitions]


def seen_in(turn: LastTurn, machine: Machine) -> list[Cause]:
    """Return the transitions of a state as they were evaluated in a turn."""
    found = []
    for number, transition in enumerate(_transitions(machine, turn.state)):
        cause, evaluated = _unseen(transition), turn.transitions.get(number)
        if evaluated is not None:
            value, elapsed_ns = evaluated
            cause = _cause(machine, turn.state, transition, elapsed_ns, turn.attributes)
            cause = cause._replace(value=value)
        found.append(cause)
    return found


def fired(
    machine: Machine, state: str, number: int, elapsed_ns: int, *, value: bool | None = True
) -> list[Cause]:
    """Return the transitions of a state of which that of this number has just fired.

    Those before it did not hold, and those after it were not evaluated. It has raised if its
    `value` is None; a number beyond them is none of them.
    """
    found = why(machine, state, elapsed_ns)
    values = [False] * number + [value]
    seen = [each._replace(value=held) for each, held in zip(found, values, strict=False)]
    unseen = _transitions(machine, state)[number + 1 :]
    return [*(seen if number >= 0 else ()), *map(_unseen, unseen)]


def _transitions(machine: Machine, state: str) -> list[Transition]:
    for each in type(machine).table.states:
        if each.name == state:
            return [*each.transitions]
    return []  # an undeclared suspend state


def _unseen(transition: Transition) -> Cause:
    return Cause(transition.target.name, transition.label, None, NOT_EVALUATED)


def _cause(
    machine: Machine,
    state: str,
    transition: Transition,
    elapsed_ns: int | None,
    attributes: Mapping[str, Any],
) -> Cause:
    parts: list[str] = []
    value: bool | None = True
    guard, limit_ms = transition.guard, transition.after_ms
    is_whole = guard is not None and guard.__code__.co_name == EXPRESSION  # of a bundle
    text = transition.label if is_whole else transition.expression
    if limit_ms is not None and not is_whole:
        if elapsed_ns is None:
            parts, value = [f"elapsed > {limit_ms:g} ms"], None
        else:
            parts, value = [elapsed_text(elapsed_ns, limit_ms)], elapsed_ns > limit_ms * 1e6
    if guard is not None:
        seen, held = f"{transition.label}: more than one expression", None
        if text is not None:
            with suppress(Exception):  # of its operators: then the guard would raise, too
                tree = parsed(text)
                operands = Operands(machine, elapsed_ns, guard, state=state, attributes=attributes)
                seen = seen_text(operands, text)
                if parts and isinstance(tree, ast.IfExp | ast.BoolOp):
                    seen = f"({seen})"
                found = operands.value(tree)
                held = found if isinstance(found, bool) else None
        parts.append(seen)
        if value is not None:
            value = value and held
    return Cause(transition.target.name, transition.label, value, " and ".join(parts) or "always")
