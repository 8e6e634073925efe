"""Statistics: what each machine did, and how long it took.

Durations are counted in *histograms* of fixed size: whatever it counts, and however long, a meter
needs no more memory, and a quantile is right to a thirty-second. A *stopwatch* times the turns. A
turn begins when the one before it has ended, so that each costs one look at the clock; only the
first of a round, and each that was waited for, begins with a look of its own.

`Histogram` and `Timing`, which every timed turn needs, are defined here in Python; where the
extension was compiled, its twins take their places, and the definitions stay as
`DefinedHistogram` and `DefinedTiming`. See `ringlet` for why.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from typing import TYPE_CHECKING, NamedTuple, Self, TypeVar

from llfsm.runtime.engine.clock import NEVER
from llfsm.runtime.log import logger

if TYPE_CHECKING:
    from llfsm.runtime.engine.clock import Clock
    from llfsm.runtime.engine.ringlet import SeatFields

S = TypeVar("S", bound="SeatFields")

_RANGES = 640  # those up to two hours


class Histogram:
    """Count durations in ranges that are a sixteenth to a thirty-second of them wide.

    Those below 32 ns have a range each; a negative one counts as 0. Its size is fixed, however long
    it counts. `counts` are the numbers of durations in each range, the last of which has no upper
    end, `total` is their sum, and `longest_ns` the greatest duration.
    """

    __slots__ = ("counts", "longest_ns", "total")

    def __init__(self) -> None:
        self.counts = [0] * _RANGES
        self.total = 0
        self.longest_ns = 0

    def add(self, ns: int, /) -> None:
        """Count a duration."""
        ns = max(ns, 0)
        shift = max(ns.bit_length() - 5, 0)  # of ns >> shift the sixteens bit is set
        self.counts[min((shift << 4) + (ns >> shift), _RANGES - 1)] += 1
        self.total += 1
        self.longest_ns = max(self.longest_ns, ns)


class Timing:
    """Time turns, one after the other; the stopwatch, which is one, has a meter for each name."""

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

    def take(self, seat: SeatFields, fired: bool, /) -> None:
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

    def _meter_of(self, seat: SeatFields) -> Meter:
        """Give the seat a meter, and return it; the twin in C calls the same name."""
        raise NotImplementedError


class MeterFields:
    """The fields of a meter that a turn counts in."""

    __slots__ = ("costs", "fired", "jitters", "late_ns", "overruns", "since_ns", "worst_overrun_ns")
    costs: Histogram
    jitters: Histogram
    fired: int
    overruns: int
    worst_overrun_ns: int
    since_ns: int
    late_ns: int


DefinedHistogram = Histogram
DefinedTiming = Timing
if not TYPE_CHECKING:  # the definitions have the types
    with suppress(ImportError):
        from llfsm.runtime.engine._ringlet import Histogram, MeterFields, Timing


class Spread(NamedTuple):
    """Half of the values are at most `p50`, 99 in 100 at most `p99`, all at most `max`.

    Microseconds; the first two are right to a thirty-second (3 %), below 32 ns exactly.
    """

    p50: float
    p99: float
    max: float

    @classmethod
    def of(cls, histogram: Histogram) -> Self | None:
        """Read a histogram; None if it is empty. Quantiles are middles of ranges."""
        if not histogram.total:
            return None
        p50, p99 = (_quantile(histogram, part) for part in (0.5, 0.99))
        return cls(p50, p99, histogram.longest_ns / 1e3)


def doublings(histogram: Histogram) -> tuple[int, ...]:
    """Count the durations shorter than 1 us, of the others those than 2 us, 4 us and so on."""
    found: list[int] = []
    for number, count in enumerate(histogram.counts):
        if count:
            place = (int(_middle_ns(number)) // 1000).bit_length()
            found += [0] * (place + 1 - len(found))
            found[place] += count
    return tuple(found)


def _quantile(histogram: Histogram, part: float) -> float:
    left = part * histogram.total
    number = -1
    counts = histogram.counts
    while left > 0:
        number += 1
        left -= counts[number]
    return min(_middle_ns(number), histogram.longest_ns) / 1e3


def _middle_ns(number: int) -> float:
    shift = max((number >> 4) - 1, 0)  # which power of two is the width of the range
    return (number - (shift << 4) + 0.5) * 2**shift if shift else number


class MachineStatistics(NamedTuple):
    """The statistics of a machine, also of one that has been unloaded.

    `state_s` are the seconds spent in each state, `cost_us` is how long ringlets took. With a
    period or a timetable, `jitter_us` is by how much the time from one turn to the next differed
    from the planned one, and `overruns` counts the turns that ended after their deadline, the
    worst of them by `worst_overrun_us`. `late_us` is by how much turns began after they were due;
    `late_counts` counts those that were late by less than 1 us, less than 2 us, 4 us and so on.
    `realtime` is the priority of SCHED_FIFO that turns had, and `cpu` their only core, if any.
    `passed_over` are those of the `ringlets` that were counted and not run, as the machine waited
    and they could change nothing: nothing else is measured of them.
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
    passed_over: int = 0


class Meter(MeterFields):
    """Count and measure the ringlets of the machines of one name, which come one after another."""

    __slots__ = ("_seat", "_state_ns", "name", "passed_over")

    def __init__(self, name: str):
        self.name = name
        self.costs = Histogram()
        self.jitters = Histogram()
        self.fired = 0
        self.overruns = 0
        self.worst_overrun_ns = 0
        self.since_ns = 0  # when the machine came into its state
        self.late_ns = NEVER  # by how much the last turn began after it was due
        self.passed_over = 0  # turns that were not run, as they would have changed nothing
        self._seat: SeatFields | None = None  # the machine's
        self._state_ns: dict[str, int] = {}  # in the states of those before it

    @property
    def is_seated(self) -> bool:
        """True if a machine is loaded whose turns it measures."""
        return self._seat is not None

    def seat(self, seat: SeatFields) -> None:
        """Measure the turns of a machine that was loaded."""
        self._seat, seat.meter = seat, self

    @property
    def turns(self) -> int:
        """The number of turns so far, with those that were passed over."""
        return self.costs.total + self.passed_over

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
            self.turns,
            self.fired,
            {state: ns / 1e9 for state, ns in self.state_ns(now_ns).items()},
            Spread.of(self.costs) or Spread(0.0, 0.0, 0.0),
            Spread.of(self.jitters),
            self.overruns,
            self.worst_overrun_ns / 1e3,
            None if lateness is None else Spread.of(lateness),
            () if lateness is None else doublings(lateness),
            passed_over=self.passed_over,
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
        """Return the histogram of how late turns of a machine, or rounds (""), begin."""
        return self._lateness.setdefault(name, Histogram())

    def time_nested(self, turn: Callable[[S], bool], seat: S) -> bool:
        """Run a turn that is nested in another machine's, and note what it took."""
        outer_ns, fired = self.begin_ns, False
        self.begin()
        try:
            fired = turn(seat)
        finally:
            self.take(seat, fired)
            self.begin_ns = outer_ns
        return fired

    def _meter_of(self, seat: SeatFields) -> Meter:
        meter = self._meters.get(seat.name) or self._meters.setdefault(seat.name, Meter(seat.name))
        meter.seat(seat)
        return meter

    def pass_over(self, rounds: int) -> None:
        """Count rounds that are not run, as they would have changed nothing."""
        for meter in self._meters.values():
            meter.passed_over += rounds * meter.is_seated

    def rest(self, name: str) -> None:
        """Note that a machine is unloaded."""
        if name in self._meters:
            self._meters[name].unseat(self.now())

    def progress(self, name: str) -> tuple[int, int]:
        """Return the numbers of ringlets and of overruns of a machine."""
        meter = self._meters.get(name)
        return (0, 0) if meter is None else (meter.turns, meter.overruns)

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
                    meter.turns,
                    meter.worst_overrun_ns / 1e3,
                )
