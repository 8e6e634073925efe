"""What each machine did and how long it took."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

from llfsm.runtime.engine.clock import NEVER
from llfsm.runtime.engine.failure import logger
from llfsm.runtime.engine.histogram import Spread, doublings
from llfsm.runtime.engine.twin import Histogram, MeterFields, Timing

if TYPE_CHECKING:
    from llfsm.runtime.engine.clock import Clock
    from llfsm.runtime.engine.seat import Seat


class MachineStatistics(NamedTuple):
    """The statistics of a machine, also of one that has been unloaded.

    `state_s` are the seconds spent in each state, `cost_us` is how long ringlets took. With a
    period or a timetable, `jitter_us` is by how much the time from one turn to the next differed
    from the planned one, and `overruns` counts the turns that ended after their deadline, the
    worst of them by `worst_overrun_us`. `late_us` is by how much turns began after they were due;
    `late_counts` counts those that were late by less than 1 us, less than 2 us, 4 us and so on.
    `realtime` is the priority of SCHED_FIFO that turns had, and `cpu` their only core, if any.
    """

    machine: str
    ringlets: int
    fired: int
    state_s: dict[str, float]
    cost_us: Spread
    jitter_us: Spread | None
    overruns: int
    worst_overrun_us: float
    late_us: Spread | None = None
    late_counts: tuple[int, ...] = ()
    realtime: int | None = None
    cpu: int | None = None


class Meter(MeterFields):
    """Count and measure the ringlets of the machines of one name, which come one after another."""

    __slots__ = ("_seat", "_state_ns", "name")

    def __init__(self, name: str):
        self.name = name
        self.costs = Histogram()
        self.jitters = Histogram()
        self.fired = 0
        self.overruns = 0
        self.worst_overrun_ns = 0
        self.since_ns = 0  # when the machine came into its state
        self.late_ns = NEVER  # by how much the last turn began after it was due
        self._seat: Seat | None = None  # the machine's
        self._state_ns: dict[str, int] = {}  # in the states of those before it

    def seat(self, seat: Seat) -> None:
        """Measure the turns of a machine that was loaded."""
        self._seat, seat.meter = seat, self

    def unseat(self, now_ns: int) -> None:
        """Note that the machine is unloaded: it is in no state, and no turn of it is due."""
        self._state_ns = self.state_ns(now_ns)
        self._seat = None
        self.late_ns = NEVER

    def state_ns(self, now_ns: int) -> dict[str, int]:
        """Return the time in each state up to now."""
        found = dict(self._state_ns)
        seat = self._seat
        if seat is not None and seat.timed is not None:
            for state in dict.fromkeys((*seat.states.values(), seat.suspension)):
                if state.spent_ns != NEVER:
                    spent_ns = state.spent_ns
                    if state is seat.timed:
                        spent_ns += now_ns - self.since_ns
                    found[state.name] = found.get(state.name, 0) + spent_ns
        return found

    def read(self, now_ns: int, lateness: Histogram | None) -> MachineStatistics:
        """Return the statistics up to now."""
        return MachineStatistics(
            self.name,
            self.costs.total,
            self.fired,
            {state: ns / 1e9 for state, ns in self.state_ns(now_ns).items()},
            Spread.of(self.costs) or Spread(0.0, 0.0, 0.0),
            Spread.of(self.jitters),
            self.overruns,
            self.worst_overrun_ns / 1e3,
            None if lateness is None else Spread.of(lateness),
            () if lateness is None else doublings(lateness),
        )


class Stopwatch(Timing):
    """Time the turns of an arrangement's machines, with one meter for each name."""

    def __init__(self, clock: Clock):
        self.now = clock.now_ns
        self.begin_ns = 0
        self.due_ns = self.deadline_ns = NEVER
        self._meters: dict[str, Meter] = {}
        self._lateness: dict[str, Histogram] = {}

    def lateness(self, name: str) -> Histogram:
        """Return what is to count by how much turns of a machine, or rounds (""), begin late."""
        return self._lateness.setdefault(name, Histogram())

    def time_nested(self, turn: Callable[[Seat], bool], seat: Seat) -> bool:
        """Run a turn that is nested in another machine's, and note what it took."""
        outer_ns, fired = self.begin_ns, False
        self.begin()
        try:
            fired = turn(seat)
        finally:
            self.take(seat, fired)
            self.begin_ns = outer_ns
        return fired

    def _meter_of(self, seat: Seat) -> Meter:
        meter = self._meters.get(seat.name) or self._meters.setdefault(seat.name, Meter(seat.name))
        meter.seat(seat)
        return meter

    def rest(self, name: str) -> None:
        """Note that a machine is unloaded."""
        if name in self._meters:
            self._meters[name].unseat(self.now())

    def progress(self, name: str) -> tuple[int, int]:
        """Return the numbers of ringlets and of overruns of a machine."""
        meter = self._meters.get(name)
        return (0, 0) if meter is None else (meter.costs.total, meter.overruns)

    def read(self) -> tuple[MachineStatistics, ...]:
        """Return the statistics of all machines, in order of first turns."""
        now_ns, of_rounds = self.now(), self._lateness.get("")
        return tuple(
            meter.read(now_ns, self._lateness.get(name, of_rounds))
            for name, meter in self._meters.items()
        )

    def end(self) -> None:
        """Stop counting time, and log which machines were late."""
        for meter in self._meters.values():
            meter.unseat(self.now())
            if meter.overruns:
                logger().warning(
                    "%s: %d of %d turns ended after their deadline, the worst by %.0f us",
                    meter.name,
                    meter.overruns,
                    meter.costs.total,
                    meter.worst_overrun_ns / 1e3,
                )
