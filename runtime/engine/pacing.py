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
from .histogram import Histogram

if TYPE_CHECKING:
    from .clock import Clock
    from .schedule import TimeSlot
    from .seat import Seat

__all__ = ["Pacer"]

_CATCH_UP_NS = 1_000_000_000


class Pacer:
    """Wait until turns are due.

    `next_ns` is when the next round is due, None before the first; `due_ns` and `deadline_ns` are
    those of the turn handed out last, which began at `begin_ns`; `skipped` counts the rounds that
    were left out. `sleep_until` returns whether turns are still wanted. `lateness` is by how much
    turns began after they were due, by machine, or of all rounds under "" where they have a period.
    """

    def __init__(self, cycle_us: int, clock: Clock, sleep_until: Callable[[int], bool]):
        self.begin_ns = 0
        self.due_ns = 0
        self.deadline_ns = 0
        self.skipped = 0
        self.lateness: dict[str, Histogram] = {}
        self._cycle_ns = cycle_us * 1_000
        self._clock = clock
        self._sleep_until = sleep_until
        self.next_ns: int | None = None

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
        self.due_ns = begin_ns
        self.deadline_ns = self.next_ns = begin_ns + self._cycle_ns
        return self._wait(begin_ns, "")

    def turns(self, slots: Iterable[TimeSlot], seats: Mapping[str, Seat]) -> Iterator[Seat | None]:
        """Yield the seat of each slot of the round when due; None if its machine is gone."""
        begin_ns = self.due_ns
        for machine, start_us, deadline_us in slots:
            self.due_ns = begin_ns + start_us * 1_000
            self.deadline_ns = self.due_ns + deadline_us * 1_000
            if not self._wait(self.due_ns, machine):
                return
            yield seats.get(machine)

    def _wait(self, due_ns: int, machine: str) -> bool:
        wanted = self._sleep_until(due_ns)
        self.begin_ns = self._clock.now_ns()
        if wanted:
            late = self.lateness.get(machine) or self.lateness.setdefault(machine, Histogram())
            late.add(max(self.begin_ns - due_ns, 0))
        return wanted
