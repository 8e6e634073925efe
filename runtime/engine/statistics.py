"""What each machine did and how long it took."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

from .failure import logger
from .histogram import NEAR, Histogram, Spread, range_of

if TYPE_CHECKING:
    from .clock import Clock
    from .pacing import Pacer
    from .seat import Seat

__all__ = ["MachineStatistics", "Meter", "Stopwatch"]

_AT_REST = object()


class MachineStatistics(NamedTuple):
    """The statistics of a machine, also of one that has been unloaded.

    `state_s` are the seconds spent in each state, `cost_us` is how long ringlets took. With a
    period or a timetable, `jitter_us` is by how much the time from one turn to the next differed
    from the planned one, and `overruns` counts the turns that ended after their deadline, the
    worst of them by `worst_overrun_us`. `late_us` is by how much turns began after they were due;
    `late_counts` counts those that were late by less than 1 us, less than 2 us, 4 us and so on.
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


class Meter:
    """Count and measure the ringlets of the machines of one name."""

    __slots__ = (
        "_begin_ns",
        "_late_ns",
        "_state",
        "_state_ns",
        "costs",
        "fired",
        "jitters",
        "name",
        "overruns",
        "previous",
        "worst_overrun_ns",
    )

    def __init__(self, name: str):
        self.name = name
        self.fired = 0
        self.overruns = 0
        self.worst_overrun_ns = 0
        self.costs = Histogram()
        self.jitters = Histogram()
        self.previous: object = _AT_REST  # the seat's, after the last turn
        self._state = ""  # that of the turns since `_begin_ns`
        self._begin_ns = 0
        self._state_ns: dict[str, int] = {}
        self._late_ns: int | None = None  # by how much the last turn began after it was due

    @property
    def ringlets(self) -> int:
        """The number of turns."""
        return self.costs.total

    def enter(self, seat: Seat, begin_ns: int) -> None:
        """Note that the turns since `begin_ns` belong to another state."""
        self.rest(begin_ns)
        self.previous = seat.previous
        self._state = (seat.previous or seat.current).name
        self._begin_ns = begin_ns
        self._state_ns.setdefault(self._state, 0)

    def note_plan(self, begin_ns: int, end_ns: int, due_ns: int, deadline_ns: int) -> None:
        """Take when a turn was due and when it had to be over."""
        late_ns = begin_ns - due_ns
        if self._late_ns is not None:
            self.jitters.add(abs(late_ns - self._late_ns))
        self._late_ns = late_ns
        if end_ns > deadline_ns:
            self.overruns += 1
            self.worst_overrun_ns = max(self.worst_overrun_ns, end_ns - deadline_ns)

    def rest(self, now_ns: int) -> None:
        """Note that the machine is in no state any more."""
        if self.previous is not _AT_REST:
            self._state_ns[self._state] += now_ns - self._begin_ns
            self.previous = _AT_REST

    def unload(self, now_ns: int) -> None:
        """Note that the machine is unloaded: no turn of it is due any more."""
        self.rest(now_ns)
        self._late_ns = None

    def read(self, now_ns: int, lateness: Histogram | None) -> MachineStatistics:
        """Return the statistics up to now."""
        state_ns = dict(self._state_ns)
        if self.previous is not _AT_REST:
            state_ns[self._state] += now_ns - self._begin_ns
        return MachineStatistics(
            self.name,
            self.ringlets,
            self.fired,
            {state: ns / 1e9 for state, ns in state_ns.items()},
            self.costs.spread() or Spread(0.0, 0.0, 0.0),
            self.jitters.spread(),
            self.overruns,
            self.worst_overrun_ns / 1e3,
            None if lateness is None else lateness.spread(),
            () if lateness is None else lateness.doublings(),
        )


class Stopwatch:
    """Time the turns of an arrangement's machines, with one meter for each name.

    A turn begins when the one before it has ended, so that each costs one look at the clock. Only
    the first of a round, and each that was waited for, begins with a look of its own.
    """

    def __init__(self, clock: Clock, pacer: Pacer | None):
        self._clock = clock
        self._pacer = pacer
        self._meters: dict[str, Meter] = {}
        self.begin_ns = 0  # of the turn that is to come, unless the pacer knows

    def begin(self) -> bool:
        """Begin a round that has no due time, and return True."""
        self.begin_ns = self._clock.now_ns()
        return True

    def around(self, turn: Callable[[Seat], bool]) -> Callable[[Seat], bool]:
        """Return `turn`, timed by the meter of its machine."""
        now, pacer, meter_of = self._clock.now_ns, self._pacer, self._meter_of
        near, near_ns, beat = NEAR, len(NEAR), self._pacer or self

        def timed_turn(seat: Seat) -> bool:
            fired = False
            try:
                fired = turn(seat)
            finally:  # in line, as each call would cost a quarter of all this
                end_ns = now()
                begin_ns = beat.begin_ns
                beat.begin_ns = end_ns
                cost_ns = end_ns - begin_ns
                meter = seat.meter
                if meter is None:
                    meter = meter_of(seat)
                costs = meter.costs
                costs.counts[near[cost_ns] if cost_ns < near_ns else range_of(cost_ns)] += 1
                if cost_ns > costs.longest_ns:
                    costs.longest_ns = cost_ns
                if fired:
                    meter.fired += 1
                if seat.previous is not meter.previous:
                    meter.enter(seat, begin_ns)
                if pacer is not None:
                    meter.note_plan(begin_ns, end_ns, pacer.due_ns, pacer.deadline_ns)
            return fired

        return timed_turn

    def within(self, turn: Callable[[Seat], bool]) -> Callable[[Seat], bool]:
        """Return `turn`, timed as one that is nested in another machine's."""
        timed, beat = self.around(turn), self._pacer or self

        def nested_turn(seat: Seat) -> bool:
            outer_ns, beat.begin_ns = beat.begin_ns, self._clock.now_ns()
            try:
                return timed(seat)
            finally:
                beat.begin_ns = outer_ns

        return nested_turn

    def _meter_of(self, seat: Seat) -> Meter:
        name = seat.name
        seat.meter = self._meters.get(name) or self._meters.setdefault(name, Meter(name))
        return seat.meter

    def rest(self, name: str) -> None:
        """Note that a machine is unloaded."""
        if name in self._meters:
            self._meters[name].unload(self._clock.now_ns())

    def progress(self, name: str) -> tuple[int, int]:
        """Return the numbers of ringlets and of overruns of a machine."""
        meter = self._meters.get(name)
        return (0, 0) if meter is None else (meter.ringlets, meter.overruns)

    def read(self) -> tuple[MachineStatistics, ...]:
        """Return the statistics of all machines, in order of first turns."""
        now_ns = self._clock.now_ns()
        late = {} if self._pacer is None else self._pacer.lateness
        return tuple(
            meter.read(now_ns, late.get(name) or late.get(""))
            for name, meter in self._meters.items()
        )

    def end(self) -> None:
        """Stop counting time, and log which machines were late."""
        for meter in self._meters.values():
            meter.unload(self._clock.now_ns())
            if meter.overruns:
                logger().warning(
                    "%s: %d of %d turns ended after their deadline, the worst by %.0f us",
                    meter.name,
                    meter.overruns,
                    meter.ringlets,
                    meter.worst_overrun_ns / 1e3,
                )
