"""What each turn costs if it is timed: a look at the clock, whose reading is counted."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from llfsm.runtime.engine.clock import NEVER

if TYPE_CHECKING:
    from llfsm.runtime.engine.seat import Seat
    from llfsm.runtime.engine.statistics import Meter
    from llfsm.runtime.engine.twin import Histogram


class Timing:
    """Time the turns, one after the other; the stopwatch, which is one, has a meter for each name.

    A turn begins when the one before it has ended, so that each costs one look at the clock. Only
    the first of a round, and each that was waited for, begins with a look of its own.
    """

    now: Callable[[], int]
    """The clock."""
    begin_ns: int
    """When the turn that is to come begins."""
    due_ns: int
    """When it is due."""
    deadline_ns: int
    """When it must be over; NEVER if it has no plan."""

    def begin(self) -> bool:
        """Begin a turn now, and return True."""
        now = self.now
        self.begin_ns = now()
        return True

    def begin_due(self, due_ns: int, deadline_ns: int, lateness: Histogram, /) -> None:
        """Begin one that has been waited for, and count by how much it is late."""
        self.begin()
        self.due_ns, self.deadline_ns = due_ns, deadline_ns
        lateness.add(self.begin_ns - due_ns)

    def take(self, seat: Seat, fired: bool, /) -> None:
        """Note that a turn has ended and that the next begins."""
        now = self.now
        begin_ns, end_ns = self.begin_ns, now()
        self.begin_ns = end_ns
        meter = seat.meter
        if meter is None:
            meter = self._meter_of(seat)
        meter.costs.add(end_ns - begin_ns)
        meter.fired += fired
        state, before = seat.previous or seat.current, seat.timed
        if state is not before:
            if before is not None:
                before.spent_ns += begin_ns - meter.since_ns
            state.spent_ns = max(state.spent_ns, 0)
            seat.timed, meter.since_ns = state, begin_ns
        if self.deadline_ns == NEVER:
            return
        late_ns = begin_ns - self.due_ns
        if meter.late_ns != NEVER:
            meter.jitters.add(abs(late_ns - meter.late_ns))
        meter.late_ns = late_ns
        if end_ns > self.deadline_ns:
            meter.overruns += 1
            meter.worst_overrun_ns = max(meter.worst_overrun_ns, end_ns - self.deadline_ns)

    def _meter_of(self, seat: Seat) -> Meter:
        """Give the seat a meter, and return it; the twin in C calls the same name."""
        raise NotImplementedError
