"""When machines have their turns, if not one after the other as fast as they can: a timetable."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import pairwise
from math import lcm
from typing import NamedTuple, Self

from .errors import ScheduleError

__all__ = ["Requirement", "TimeSlot", "Timetable"]

MOST_SLOTS = 100_000
"""A longer cycle is refused: periods that hardly divide each other make cycles of hours."""


class TimeSlot(NamedTuple):
    """A turn of a machine: its start counts from the cycle's begin, its deadline from the start."""

    machine: str
    start_us: int
    deadline_us: int


class Requirement(NamedTuple):
    """What a machine needs: a turn at each of `starts_us` in every period, each done in time.

    All are microseconds; starts count from the period's begin, the deadline from the start.
    """

    machine: str
    period_us: int
    deadline_us: int
    starts_us: tuple[int, ...] = (0,)


class Timetable:
    """A cycle of slots that repeats for ever: slot n of cycle c starts at c cycles + its start.

    Slots are in the order in which their machines get the token, which is that of their starts.
    """

    def __init__(self, slots: Iterable[TimeSlot], cycle_us: int):
        self.slots = tuple(slots)
        self.cycle_us = cycle_us
        self.machines = tuple(dict.fromkeys(slot.machine for slot in self.slots))
        if not self.slots:
            raise ScheduleError("a timetable needs a slot")
        for slot in self.slots:
            if slot.start_us < 0:
                raise ScheduleError(f"{slot.machine}: starts at {slot.start_us} us, before 0")
            if slot.deadline_us < 1:
                raise ScheduleError(
                    f"{slot.machine}: its deadline is {slot.deadline_us} us; it must be 1 or more"
                )
        for before, after in pairwise(self.slots):
            if after.start_us < before.start_us:
                raise ScheduleError(
                    f"{after.machine} starts at {after.start_us} us, but the slot before it, of "
                    f"{before.machine}, at {before.start_us} us: list slots in order of time"
                )
        if self.slots[-1].start_us - self.slots[0].start_us >= cycle_us:
            raise ScheduleError(
                f"the slots from {self.slots[0].start_us} to {self.slots[-1].start_us} us do not "
                f"fit into a cycle of {cycle_us} us"
            )

    @classmethod
    def meeting(cls, requirements: Iterable[Requirement]) -> Self:
        """Return the timetable in which each machine has what it needs.

        The cycle is the least common multiple of the periods. Of machines that start at the same
        time the one listed first goes first. Raise `ScheduleError` if that cannot be.
        """
        needs = list(requirements)
        for need in needs:
            if need.period_us < 1:
                raise ScheduleError(
                    f"{need.machine}: its period is {need.period_us} us; it must be 1 or more"
                )
            if not need.starts_us:
                raise ScheduleError(f"{need.machine}: it would never have a turn: give it a start")
            for start in need.starts_us:
                if not 0 <= start < need.period_us:
                    raise ScheduleError(
                        f"{need.machine}: {start} us is not a start within its period of "
                        f"{need.period_us} us"
                    )
        cycle_us = lcm(*(need.period_us for need in needs))
        turns = sum(cycle_us // need.period_us * len(need.starts_us) for need in needs)
        if turns > MOST_SLOTS:
            raise ScheduleError(
                f"the periods have {cycle_us / 1e6:g} s in common, {turns} turns; choose periods "
                f"that are multiples of each other (at most {MOST_SLOTS} turns)"
            )
        slots = [
            TimeSlot(need.machine, begin_us + start_us, need.deadline_us)
            for need in needs
            for begin_us in range(0, cycle_us, need.period_us)
            for start_us in need.starts_us
        ]
        return cls(sorted(slots, key=lambda slot: slot.start_us), cycle_us)
