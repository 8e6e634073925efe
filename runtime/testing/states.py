"""The states that a machine entered, against those expected; the current states, for failures."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import SequenceMatcher

from ..engine.arrangement import Arrangement
from ..engine.errors import UnknownMachineError
from ..engine.events import Event, Section
from ..engine.machine import Machine
from .errors import StatesError

__all__ = ["assert_states", "current_states", "name_of", "states_of"]


def states_of(trace: Iterable[Event], machine: str) -> list[str]:
    """Return the states that `machine` entered, in order, its suspend state included.

    Raise `UnknownMachineError` if the trace has no section of that machine.
    """
    return [section.state for section in _entries(trace, machine)]


def assert_states(trace: Iterable[Event], machine: str, expected: Iterable[str]) -> None:
    """Raise `StatesError`, with the difference, unless `machine` entered exactly these states."""
    entries, wanted = _entries(trace, machine), list(expected)
    found = [section.state for section in entries]
    if found == wanted:
        return
    lines = [f"{machine} did not enter the states expected (- missing, + unexpected):"]
    for kind, a, b, c, d in SequenceMatcher(None, wanted, found, autojunk=False).get_opcodes():
        mark = " " if kind == "equal" else "+"
        if kind != "equal":
            lines += [f"  - {state}" for state in wanted[a:b]]
        lines += [
            f"  {mark} {section.state}  at {section.time_ns / 1e6:g} ms" for section in entries[c:d]
        ]
    raise StatesError("\n".join(lines))


def _entries(trace: Iterable[Event], machine: str) -> list[Section]:
    sections = [event for event in trace if isinstance(event, Section)]
    known = dict.fromkeys(section.machine for section in sections)
    if machine not in known:
        raise UnknownMachineError(machine, known, "traced")
    return [s for s in sections if s.machine == machine and s.section == "OnEntry"]


def current_states(arrangement: Arrangement, machines: Iterable[Machine]) -> str:
    """Return a line for each machine, each after a line break: its state, and for how long."""
    now_ns = arrangement.clock.now_ns()
    return (
        "".join(f"\n  {_current_state(machine, now_ns)}" for machine in machines)
        or "\n  no machines"
    )


def _current_state(machine: Machine, now_ns: int) -> str:
    seat = machine._seat
    status = seat.standing()
    text = f"{status.machine}: {status.state}"
    if status.entered_ns is None or seat.current is not seat.previous:
        text += ", not yet entered"
    else:
        text += f" for {(now_ns - status.entered_ns) / 1e6:g} ms"
    if status.suspended:
        text += ", suspended"
    if status.request is not None:
        text += f", to {status.request}"
    return text if seat.taken else f"{text}, unloaded"


def name_of(function: object, default: str) -> str:
    """Return the name of a function or class as in source text; `default` for a lambda."""
    name = str(getattr(function, "__qualname__", default)).rpartition("<locals>.")[2]
    return default if "<" in name else name
