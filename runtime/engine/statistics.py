"""What each machine did and how long it took."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

from .failure import logger

if TYPE_CHECKING:
    from .clock import Clock
    from .pacing import Pacer
    from .seat import Seat

__all__ = ["MachineStatistics", "Meter", "Spread", "Stopwatch"]


class Spread(NamedTuple):
    """Half of the values are at most `p50`, 99 in 100 at most `p99`, all at most `max`.

    Microseconds; the first two to 3 %.
    """

    p50: float
    p99: float
    max: float


class MachineStatistics(NamedTuple):
    """The statistics of a machine, also of one that has been unloaded.

    `state_s` are the seconds spent in each state, `cost_us` is how long ringlets took. With a
    period or a timetable, `jitter_us` is by how much the time from one turn to the next differed
    from the planned one, and `overruns` counts the turns that ended after their deadline, the
    worst of them by `worst_overrun_us`.
    """

    machine: str
    ringlets: int
    fired: int
    state_s: dict[str, float]
    cost_us: Spread
    jitter_us: Spread | None
    overruns: int
    worst_overrun_us: float


class Meter:
    """Count and measure the ringlets of the machines of one name."""

    __slots__ = (
        "_begin_ns",
        "_costs",
        "_jitters",
        "_planned",
        "_state",
        "_state_ns",
        "fired",
        "name",
        "overruns",
        "ringlets",
        "worst_overrun_ns",
    )

    def __init__(self, name: str):
        self.name = name
        self.ringlets = 0
        self.fired = 0
        self.overruns = 0
        self.worst_overrun_ns = 0
        self._costs = _Histogram()
        self._jitters = _Histogram()
        self._state_ns: dict[str, int] = {}
        self._state: str | None = None  # that of the last turn, and when the turn began
        self._begin_ns = 0
        self._planned: tuple[int, int] | None = None  # when that began and was due

    def note(self, state: str, fired: bool, begin_ns: int, end_ns: int) -> None:
        """Take a turn of a machine in `state`, and whether a transition fired."""
        self.ringlets += 1
        self.fired += fired
        self._costs.add(end_ns - begin_ns)
        if self._state is not None:
            self._state_ns[self._state] += begin_ns - self._begin_ns
        self._state_ns.setdefault(state, 0)
        self._state, self._begin_ns = state, begin_ns

    def note_plan(self, begin_ns: int, end_ns: int, due_ns: int, deadline_ns: int) -> None:
        """Take when that turn was due and when it had to be over."""
        if self._planned is not None:
            before_ns, due_before_ns = self._planned
            self._jitters.add(abs(begin_ns - before_ns - (due_ns - due_before_ns)))
        self._planned = begin_ns, due_ns
        if end_ns > deadline_ns:
            self.overruns += 1
            self.worst_overrun_ns = max(self.worst_overrun_ns, end_ns - deadline_ns)

    def rest(self, now_ns: int) -> None:
        """Note that the machine is unloaded: it is in no state any more."""
        if self._state is not None:
            self._state_ns[self._state] += now_ns - self._begin_ns
            self._state = self._planned = None

    def read(self, now_ns: int) -> MachineStatistics:
        """Return the statistics up to now."""
        state_ns = dict(self._state_ns)
        if self._state is not None:
            state_ns[self._state] += now_ns - self._begin_ns
        return MachineStatistics(
            self.name,
            self.ringlets,
            self.fired,
            {state: ns / 1e9 for state, ns in state_ns.items()},
            self._costs.spread() or Spread(0.0, 0.0, 0.0),
            self._jitters.spread(),
            self.overruns,
            self.worst_overrun_ns / 1e3,
        )


class Stopwatch:
    """Time the turns of an arrangement's machines, with one meter for each name."""

    def __init__(self, clock: Clock, pacer: Pacer | None):
        self._clock = clock
        self._pacer = pacer
        self._meters: dict[str, Meter] = {}

    def around(self, turn: Callable[[Seat], bool]) -> Callable[[Seat], bool]:
        """Return `turn`, timed by the meter of its machine."""
        now, pacer, meters = self._clock.now_ns, self._pacer, self._meters

        def timed_turn(seat: Seat) -> bool:
            begin_ns = now()
            fired = False
            try:
                fired = turn(seat)
            finally:
                end_ns = now()
                meter = meters.get(seat.name) or meters.setdefault(seat.name, Meter(seat.name))
                state = seat.current if seat.previous is None else seat.previous
                meter.note(state.name, fired, begin_ns, end_ns)
                if pacer is not None:
                    meter.note_plan(begin_ns, end_ns, pacer.due_ns, pacer.deadline_ns)
            return fired

        return timed_turn

    def rest(self, name: str) -> None:
        """Note that a machine is unloaded."""
        if name in self._meters:
            self._meters[name].rest(self._clock.now_ns())

    def progress(self, name: str) -> tuple[int, int]:
        """Return the numbers of ringlets and of overruns of a machine."""
        meter = self._meters.get(name)
        return (0, 0) if meter is None else (meter.ringlets, meter.overruns)

    def read(self) -> tuple[MachineStatistics, ...]:
        """Return the statistics of all machines, in order of first turns."""
        now_ns = self._clock.now_ns()
        return tuple(meter.read(now_ns) for meter in self._meters.values())

    def end(self) -> None:
        """Stop counting time, and log which machines were late."""
        for meter in self._meters.values():
            meter.rest(self._clock.now_ns())
            if meter.overruns:
                logger().warning(
                    "%s: %d of %d turns ended after their deadline, the worst by %.0f us",
                    meter.name,
                    meter.overruns,
                    meter.ringlets,
                    meter.worst_overrun_ns / 1e3,
                )


class _Histogram:
    """Count durations in ranges that are a sixteenth to a thirty-second of them wide.

    So an hour of turns at 1 kHz takes no more memory than a second of them.
    """

    __slots__ = ("_counts", "_max")

    def __init__(self) -> None:
        self._counts: dict[int, int] = {}
        self._max = 0

    def add(self, ns: int) -> None:
        shift = max(ns.bit_length() - 5, 0)
        key = (shift << 4) + (ns >> shift)  # of ns >> shift the sixteens bit is set, or shift is 0
        self._counts[key] = self._counts.get(key, 0) + 1
        if ns > self._max:
            self._max = ns

    def spread(self) -> Spread | None:
        if not self._counts:
            return None
        return Spread(self._quantile(0.5), self._quantile(0.99), self._max / 1e3)

    def _quantile(self, part: float) -> float:
        left = part * sum(self._counts.values())
        keys = iter(sorted(self._counts))
        while left > 0:
            key = next(keys)
            left -= self._counts[key]
        shift = max((key >> 4) - 1, 0)
        middle = (key - (shift << 4) + 0.5) * 2**shift if shift else key
        return min(middle, self._max) / 1e3
