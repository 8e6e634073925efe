"""When machines have their turns, if not one after the other as fast as they can.

A *timetable* gives each machine slots in a cycle that repeats for ever; a period is the cycle of
one round. The *pacer* keeps turns on this grid of time, which nothing moves: the n-th round is due
at the first one's begin plus n cycles, whatever happened before, so lateness never adds up. A turn
that is late begins at once, and the following ones too until they are on time again: none is left
out. Only if that would take more than a second's worth of rounds, as after a process was stopped,
are whole rounds skipped, and counted.

When a turn was due is the time that its machine sees. So a machine that waits for 1 s at 20 ms has
its turn after exactly 1 s, and then one that is 20 ms later, in every run, under a manual clock and
in a proof alike, as in synchronous languages and in logical execution time. That a turn was late is
measured, and no machine can tell.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from itertools import pairwise
from math import lcm
from typing import TYPE_CHECKING, NamedTuple, Self, TypeVar

from llfsm.runtime.engine.errors import LoadError, ScheduleError
from llfsm.runtime.log import logger

if TYPE_CHECKING:
    from llfsm.runtime.engine.environment import Environment
    from llfsm.runtime.engine.statistics import Histogram, Stopwatch

S = TypeVar("S")

MOST_SLOTS = 100_000
"""A longer cycle is refused: periods that hardly divide each other make cycles of hours."""


class TimeSlot(NamedTuple):
    """A turn of a machine: its start counts from the cycle's begin, its deadline from the start."""

    machine: str
    start_us: int
    deadline_us: int


class Requirement(NamedTuple):
    """The needs of a machine: a turn at each of `starts_us` in every period, each done in time.

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

    def check_has(self, machine: str) -> None:
        """Raise `LoadError` if a machine has no slot."""
        if machine not in self.machines:
            raise LoadError(
                f"{machine} has no slot in the timetable; it has slots for: "
                f"{', '.join(self.machines)}; add a [[machine]] for it to the "
                f"arrangement file, with preload = true and a period_us"
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


_CATCH_UP_NS = 1_000_000_000


class Pacer:
    """Wait until turns are due, and report when they were to machines and to the stopwatch.

    `next_ns` is when the next round is due, None before the first; `skipped` counts the rounds that
    were left out. `sleep_until` returns whether turns are still wanted. With a timetable, turns are
    waited for, too, in its `slots`.
    """

    def __init__(
        self,
        cycle_us: int,
        environment: Environment,
        stopwatch: Stopwatch,
        sleep_until: Callable[[int], bool],
        slots: Iterable[TimeSlot] = (),
    ):
        self.skipped = 0
        self._begin_ns = 0  # of the round
        self.cycle_ns = cycle_us * 1_000
        self._environment = environment
        environment.is_due(environment.clock.now_ns())
        self._stopwatch = stopwatch
        self.sleep_until = sleep_until
        self.next_ns: int | None = None
        self._lateness = stopwatch.lateness("")
        self._slots = [
            (machine, start_us * 1_000, deadline_us * 1_000, stopwatch.lateness(machine))
            for machine, start_us, deadline_us in slots
        ]

    def wait_for_round(self) -> bool:
        """Sleep until the next round is due; return False if it is not wanted any more."""
        now_ns = self._environment.clock.now_ns()
        begin_ns = now_ns if self.next_ns is None else self.next_ns
        behind_ns = now_ns - begin_ns
        if behind_ns > max(_CATCH_UP_NS, self.cycle_ns):
            lost = behind_ns // self.cycle_ns
            begin_ns += lost * self.cycle_ns
            self.skipped += lost
            logger().warning("%.3g s behind: %d rounds are left out", behind_ns / 1e9, lost)
        self.next_ns = begin_ns + self.cycle_ns
        self._begin_ns = begin_ns
        return self.wait(begin_ns, self.next_ns, self._lateness)

    def pass_over(self, rounds: int) -> None:
        """Let the next rounds be over: they would have changed nothing."""
        assert self.next_ns is not None
        self._environment.is_due(self.next_ns + (rounds - 1) * self.cycle_ns)
        self.next_ns += rounds * self.cycle_ns

    def turns(self, seats: Mapping[str, S]) -> Iterator[S | None]:
        """Yield the seat of each slot of the round when due; None if its machine is gone."""
        begin_ns = self._begin_ns
        for machine, start_ns, deadline_ns, lateness in self._slots:
            due_ns = begin_ns + start_ns
            if not self.wait(due_ns, due_ns + deadline_ns, lateness):
                return
            yield seats.get(machine)

    def wait(self, due_ns: int, deadline_ns: int, lateness: Histogram) -> bool:
        """Sleep until a turn is due, and begin to time it; return False if it is not wanted."""
        if not self.sleep_until(due_ns):
            return False
        self._environment.is_due(due_ns)
        self._stopwatch.begin_due(due_ns, deadline_ns, lateness)
        return True
