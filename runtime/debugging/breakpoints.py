"""Breakpoints: where, and under which condition, machines are to be paused.

The text of one is ``Wall:STOP`` (entering the state STOP), ``Wall:STOP->`` (leaving it by any
transition), ``Wall:STOP->TURN`` (by those to TURN), ``Wall!`` (its code raises), or
``@turtle1/pose`` (a machine has another message of the slot). ``#3`` after it means from the third
time on, and ``if x > 9`` an expression over the machine's variables and sensors, or the message.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any, Final, NamedTuple, Self

from llfsm.errors import did_you_mean
from llfsm.runtime.engine.errors import BreakpointError

from .called_machines import machines_beside
from .operands import Operands

if TYPE_CHECKING:
    from llfsm.runtime.engine.machine import Machine

__all__ = ["Breakpoint", "check_breakpoints"]

_TEXT: Final = re.compile(
    r"(?:@(?P<slot>[^\s#]+)"
    r"|(?P<machine>[^\s:@#!]+)(?:(?P<failure>!)"
    r"|:(?P<state>[^\s#]+?)(?:(?P<leave>->)(?P<target>[^\s#]*))?))"
    r"(?:#(?P<count>[1-9]\d*))?(?:\s+if\s+(?P<condition>.+))?"
)


class Breakpoint(NamedTuple):
    """One breakpoint, as its text says; without a machine, it is one of a slot's messages."""

    text: str
    machine: str = ""
    state: str = ""
    leaves: bool = False
    target: str = ""
    slot: str = ""
    least: int = 1
    """The number of the first hit at which to pause."""
    condition: ast.expr | None = None

    @classmethod
    def parse(cls, text: str) -> Self:
        """Read a breakpoint's text; raise `BreakpointError`."""
        found = _TEXT.fullmatch(text.strip())
        if found is None:
            raise BreakpointError(
                f"{text!r} is not a breakpoint; write Machine:STATE, Machine:STATE->, "
                f"Machine:STATE->TARGET, Machine! or @slot, then #2 and ` if CONDITION` as needed"
            )
        condition = None
        if found["condition"]:
            try:
                condition = ast.parse(found["condition"].strip(), mode="eval").body
            except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
                raise BreakpointError(f"{text!r}: its condition is wrong: {error}") from error
        return cls(
            text.strip(),
            found["machine"] or "",
            found["state"] or "",
            bool(found["leave"]),
            found["target"] or "",
            found["slot"] or "",
            int(found["count"] or 1),
            condition,
        )

    @property
    def fails(self) -> bool:
        """Whether it is one of a failure."""
        return bool(self.machine) and not self.state

    def holds(self, owner: Any) -> bool:
        """Return whether its condition holds of a machine or message; raise what that raises."""
        return self.condition is None or bool(Operands(owner).value(self.condition))


def check_breakpoints(
    breakpoints: Iterable[Breakpoint], machines: Mapping[str, type[Machine]], slots: Iterable[str]
) -> None:
    """Raise `BreakpointError` for one whose machine, state, transition or slot does not exist.

    `machines` are those that run, and others that they may load, by name: those beside them in
    their modules are known, too. `slots` are what they read.
    """
    known = {**machines_beside(machines.values()), **machines}
    for each in breakpoints:
        if each.slot:
            sensors = (port for cls in known.values() for port in cls.table.sensors.values())
            read = {*slots, *(sensor.slot.name for sensor in sensors)}
            _require(each, "slot that a machine reads", each.slot, read)
            continue
        cls = known.get(each.machine)
        if cls is None:
            _require(each, "machine", each.machine, machines)
            continue
        states = {state.name: state for state in cls.table.states}
        if each.state and (each.leaves or each.state != "Suspended"):
            _require(each, f"state of {each.machine}", each.state, states)
        if each.target:
            targets = {transition.target.name for transition in states[each.state].transitions}
            _require(each, f"transition from {each.state} to", each.target, targets)


def _require(breakpoint: Breakpoint, what: str, name: str, known: Iterable[str]) -> None:
    if name not in (names := sorted(known)):
        raise BreakpointError(
            f"breakpoint {breakpoint.text!r}: no {what} {name!r}; there are: "
            f"{', '.join(names) or 'none'}{did_you_mean(name, names)}"
        )
