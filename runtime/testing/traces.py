"""Which states a machine went through, and how that differs from what was expected."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import SequenceMatcher

from ..engine.errors import UnknownMachineError
from ..engine.events import Event, Section
from .errors import StatesError

__all__ = ["assert_states", "states_of"]


def states_of(trace: Iterable[Event], machine: str) -> list[str]:
    """Return the states that `machine` entered, in order; its suspend state counts, too.

    Raise `UnknownMachineError` if it has run nothing in this trace.
    """
    return [section.state for section in _entries(trace, machine)]


def assert_states(trace: Iterable[Event], machine: str, expected: Iterable[str]) -> None:
    """Raise `StatesError`, which shows the difference, unless it entered just these states."""
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
