"""Keep turns on a grid of time that nothing moves.

The n-th round is due at the first one's begin plus n cycles, whatever happened before: lateness
never adds up. A turn that is late begins at once, and the following ones too until they are on
time again, so that none is left out. Only if that would take more than a second's worth of
rounds, as after a process was stopped, are whole rounds skipped, and counted.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import TYPE_CHECKING

from .failure import logger

if TYPE_CHECKING:
    from .clock import Clock
    from .schedule import TimeSlot
    from .seat import Seat
    from .statistics import Stopwatch
    from .twin import Histogram

__all__ = ["Pacer"]

_CATCH_UP_NS = 1_000_000_000


class Pacer:
    """Wait until turns are due, and report to the stopwatch when they were, and must be over.

    `next_ns` is when the next round is due, None before the first; `skipped` counts the rounds that
    were left out. `sleep_until` returns whether turns are still wanted. With a timetable, turns are
    waited for, too, in its `slots`.
    """

    def __init__(
        self,
        cycle_us: int,
        clock: Clock,
        stopwatch: Stopwatch,
        sleep_until: Callable[[int], bool],
        slots: Iterable[TimeSlot] = (),
    ):
        self.skipped = 0
        self._begin_ns = 0  # of the round
        self._cycle_ns = cycle_us * 1_000
        self._clock = clock
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
        now_ns = self._clock.now_ns()
        begin_ns = now_ns if self.next_ns is None else self.next_ns
        behind_ns = now_ns - begin_ns
        if behind_ns > max(_CATCH_UP_NS, self._cycle_ns):
            lost = behind_ns // self._cycle_ns
            begin_ns += lost * self._cycle_ns
            self.skipped += lost
            logger().warning("%.3g s behind: %d rounds are left out", behind_ns / 1e9, lost)
        self.next_ns = begin_ns + self._cycle_ns
        self._begin_ns = begin_ns
        return self.wait(begin_ns, self.next_ns, self._lateness)

    def turns(self, seats: Mapping[str, Seat]) -> Iterator[Seat | None]:
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
        self._stopwatch.begin_due(due_ns, deadline_ns, lateness)
        return True
