"""Read a dispatch table as clfsm's ``-T`` does: two tables, separated by a blank line.

The first has a line for each machine: its bundle, its period and its deadline in microseconds and,
if it is loaded suspended or only preloaded, an `S` or a `P`. The second has a line for each slot:
the number of the machine, from 0, and the start of the slot in microseconds from the beginning of
the cycle. Tabs separate the fields. clfsm begins the next cycle when the last slot of a cycle
starts; here a cycle is a multiple of all periods, as the tables intend.
"""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Iterable
from itertools import pairwise
from math import lcm
from pathlib import Path

from ..engine.errors import ConfigurationError
from ..engine.failure import logger
from ..engine.schedule import TimeSlot, Timetable
from .plan import Plan, PlannedMachine
from .toml_files import read_text

_NUMBER = re.compile(r"[0-9]{1,12}")  # a million seconds

__all__ = ["DispatchTable", "read_dispatch_table"]


class DispatchTable(Plan, frozen=True, kw_only=True):
    """A plan with its own timetable: (machine, start_us) for each slot.

    Machines are numbered from 0. The cycle is the shortest multiple of the periods of all machines
    with slots that has room for all slots.
    """

    slots: tuple[tuple[int, int], ...]

    def timetable(self, names: Iterable[str]) -> Timetable:
        """Return the timetable for machines of these names."""
        names = tuple(names)
        slots = [
            TimeSlot(names[number], start_us, self.machines[number].deadline_us or 1)
            for number, start_us in self.slots
        ]
        even_us = lcm(*(self.machines[number].period_us or 1 for number, _ in self.slots))
        length_us = slots[-1].start_us - slots[0].start_us
        cycle_us = (length_us // even_us + 1) * even_us
        for number, turns in Counter(number for number, _ in self.slots).items():
            period_us = self.machines[number].period_us
            if period_us is not None and turns * period_us != cycle_us:
                logger().warning(
                    "%s has a period of %d us, but the table gives it %d turns in %d us",
                    names[number],
                    period_us,
                    turns,
                    cycle_us,
                )
        return Timetable(slots, cycle_us)


def read_dispatch_table(file: Path) -> DispatchTable:
    """Read a dispatch table; raise `ConfigurationError` with the line of what is wrong."""
    lines = read_text(file).split("\n")
    numbered = [(number, line.rstrip()) for number, line in enumerate(lines, 1)]
    blank = next((number for number, line in numbered if not line), len(lines))
    try:
        machines = tuple(_machine(number, line) for number, line in numbered[:blank] if line)
        slots = [
            (number, *_slot(number, line, len(machines)))
            for number, line in numbered[blank:]
            if line
        ]
        _check(machines, slots)
    except _LineError as error:
        raise ConfigurationError(error.what, file=file, line=error.line) from error
    return DispatchTable(machines=machines, slots=tuple(slot[1:] for slot in slots))


class _LineError(Exception):
    def __init__(self, line: int, what: str):
        self.line = line
        self.what = what


def _machine(line: int, text: str) -> PlannedMachine:
    fields = text.split("\t")
    if len(fields) not in (3, 4):
        raise _LineError(
            line, f"{text!r} is not: bundle, period and deadline in us, S or P; tab-separated"
        )
    path, period, deadline, *how = fields
    definition = os.path.expanduser(path)
    if not path or definition[0] == "~":
        raise _LineError(line, f"{path!r} is not the path of a bundle")
    if how not in ([], ["S"], ["P"]):
        raise _LineError(line, f"{how[0]!r} must be S (suspended) or P (preloaded)")
    return PlannedMachine(
        definition=definition,
        period_us=_number(line, "the period", period, 1),
        deadline_us=_number(line, "the deadline", deadline, 1),
        suspended=how == ["S"],
        preload=how == ["P"],
    )


def _slot(line: int, text: str, machines: int) -> tuple[int, int]:
    fields = text.split("\t")
    if len(fields) != 2:
        raise _LineError(line, f"{text!r} is not: number of a machine, start in us; tab-separated")
    machine = _number(line, "the machine", fields[0], 0)
    if machine >= machines:
        raise _LineError(line, f"there is no machine {machine}; they are 0 to {machines - 1}")
    return machine, _number(line, "the start", fields[1], 0)


def _number(line: int, what: str, text: str, least: int) -> int:
    if not _NUMBER.fullmatch(text) or int(text) < least:
        raise _LineError(line, f"{what} is {text!r}; it must be a whole number from {least}")
    return int(text)


def _check(machines: tuple[PlannedMachine, ...], slots: list[tuple[int, int, int]]) -> None:
    if not slots:
        raise _LineError(len(machines) or 1, "after a blank line, a table of slots must follow")
    for (_, _, before), (line, _, start) in pairwise(slots):
        if start < before:
            raise _LineError(line, f"starts at {start} us, before the slot above it, at {before}")
    used = {machine for _, machine, _ in slots}
    for number, planned in enumerate(machines):
        if number not in used and not planned.preload:
            raise _LineError(number + 1, f"{planned.definition} has no slot in the second table")
