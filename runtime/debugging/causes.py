"""Why a machine is still in its state: each transition's value, and the operands it has seen."""

from __future__ import annotations

import ast
from contextlib import suppress
from typing import TYPE_CHECKING, NamedTuple, Self

from llfsm.runtime.engine.source_text import EXPRESSION

from .operands import Operands, parsed

if TYPE_CHECKING:
    from llfsm.runtime.engine.machine import Machine
    from llfsm.runtime.engine.state import Transition

__all__ = ["Cause", "why"]


class Cause(NamedTuple):
    """A transition: its value on the last snapshot, None if that cannot be known without a call."""

    target: str
    label: str
    value: bool | None
    seen: str
    """The expression with the values of its parts."""

    @classmethod
    def fired(cls, machine: Machine, state: str, number: int) -> list[Self]:
        """Return the transitions of a state of which that of this number has just fired.

        Those before it did not hold, and those after it were not evaluated.
        """
        found = why(machine, state, None)
        values = [False] * number + [True] + [None] * len(found)
        return [
            cls(*cause._replace(value=value)) for cause, value in zip(found, values, strict=False)
        ]


def why(machine: Machine, state: str, elapsed_ns: int | None) -> list[Cause]:
    """Return the transitions of a state in their order, as they would be evaluated now.

    `elapsed_ns` is for how long the machine has been in the state; None if it has not entered it.
    Nothing is called that has an effect.
    """
    table = type(machine).table
    for each in table.states:
        if each.name == state:
            return [
                _cause(machine, state, transition, elapsed_ns) for transition in each.transitions
            ]
    return []  # an undeclared suspend state


def _cause(machine: Machine, state: str, transition: Transition, elapsed_ns: int | None) -> Cause:
    parts: list[str] = []
    value: bool | None = True
    guard, limit_ms = transition.guard, transition.after_ms
    is_whole = guard is not None and guard.__code__.co_name == EXPRESSION  # of a bundle
    text = transition.label if is_whole else transition.expression
    if limit_ms is not None and not is_whole:
        passed = "elapsed" if elapsed_ns is None else f"{elapsed_ns / 1e6:.6g} ms"
        parts.append(f"{passed} > {limit_ms:g} ms")
        value = None if elapsed_ns is None else elapsed_ns > limit_ms * 1e6
    if guard is not None:
        seen, held = f"{transition.label}: more than one expression", None
        if text is not None:
            with suppress(Exception):  # of its operators: then the guard would raise, too
                operands, tree = Operands(machine, elapsed_ns, guard, state=state), parsed(text)
                seen = operands.text(tree)
                if parts and isinstance(tree, ast.IfExp | ast.BoolOp):
                    seen = f"({seen})"
                found = operands.value(tree)
                held = found if isinstance(found, bool) else None
        parts.append(seen)
        if value is not None:
            value = value and held
    return Cause(transition.target.name, transition.label, value, " and ".join(parts) or "always")
