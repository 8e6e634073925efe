"""The time models: how much time passes between two turns, as the schedule of a run has it.

With a period machines see when their turn was due, which is a whole number of periods after any
other turn. More than one passes if a run is so far behind that it leaves rounds out. With a
timetable time passes between the turns of a round, too, and a machine may have several turns in a
cycle or none: all times are multiples of a unit, the largest that divides them. Without either, any
time may pass between two rounds.

Of the time for which a machine has been in its state, only the answers to the questions that its
code asks matter: is it longer than this limit? So the time in a state is a small number. With a
schedule it counts the units that have passed, up to the first at which all limits are over; with
any time it counts the limits that are over. The limits are learnt as ringlets ask about them.
"""

from __future__ import annotations

from bisect import insort
from collections.abc import Sequence
from itertools import pairwise
from math import gcd
from typing import TYPE_CHECKING, NamedTuple, Protocol

from llfsm.runtime.engine.schedule import TimeSlot, Timetable

if TYPE_CHECKING:
    from collections.abc import Iterable


class Limits(list[int]):
    """The times that code asks about in a state, in nanoseconds and in order."""

    def note(self, limit_ns: int) -> None:
        """Add a time if it is new."""
        if limit_ns not in self:
            insort(self, limit_ns)


class DueTurn(NamedTuple):
    """A turn in each round: whose it is, and when it is due."""

    place: int
    """Of the machine."""
    units: int
    """The units of time that pass before it, from the turn before it in the order of turns."""
    start_ns: int
    """When it is due, from the begin of its round."""


class TimeModel(Protocol):
    """A rule of how much time passes between two turns, by numbers for the time in a state."""

    @property
    def unit_ns(self) -> int | None:
        """The unit of all times, in nanoseconds; None if any time may pass."""

    @property
    def schedule(self) -> str:
        """The schedule of the runs that are explored, in words."""

    @property
    def not_covered(self) -> str:
        """Describe runs with this schedule that are not explored; "" if there are none."""

    def most(self, limits: Limits) -> int:
        """Return the largest number for the time in a state with these limits."""
        ...

    def elapsed_ns(self, number: int, limits: Limits) -> int:
        """Return the least time in the state, in nanoseconds, for which a number stands."""
        ...

    def steps(self, number: int, limits: Limits, units: int) -> tuple[int, ...]:
        """List by how much the number may grow while so many units of time pass."""
        ...

    def rounds(self, most: int) -> range:
        """List how many rounds after the one before a round may begin, up to `most`."""
        ...

    def order(self, groups: Sequence[tuple[str, Sequence[int]]]) -> list[DueTurn]:
        """List the turns of a round: `groups` are machines with their places and inner ones'."""
        ...

    def begin_ns(self, rounds: int) -> int:
        """Return when the round begins that is so many after the beginning."""
        ...


def _one_after_the_other(groups: Sequence[tuple[str, Sequence[int]]]) -> list[DueTurn]:
    places = [place for _, each in groups for place in each]
    return [DueTurn(place, 0 if number else 1, 0) for number, place in enumerate(places)]


class Periods:
    """Each round begins a period after the one before; with `skips`, any number of periods."""

    def __init__(self, period_ns: int, *, skips: bool = False):
        self.unit_ns = period_ns
        self.skips = skips

    @property
    def schedule(self) -> str:
        """The period, and whether rounds may be left out."""
        left_out = ", of which any number may be left out" if self.skips else ""
        return f"a round every {self.unit_ns / 1e6:g} ms{left_out}"

    @property
    def not_covered(self) -> str:
        """Rounds that are left out, unless they are explored."""
        behind = "rounds that a run leaves out when it is over a second behind"
        return "" if self.skips else f"{behind} (--skips, skips=True)"

    def most(self, limits: Limits) -> int:
        """Return after how many units all limits are over."""
        return limits[-1] // self.unit_ns + 1 if limits else 0

    def elapsed_ns(self, number: int, limits: Limits) -> int:
        """Return the time of so many units."""
        return number * self.unit_ns

    def steps(self, number: int, limits: Limits, units: int) -> tuple[int, ...]:
        """Return the number of units, until all limits are over."""
        return (min(units, self.most(limits) - number),)

    def rounds(self, most: int) -> range:
        """List 1 or, if rounds may be left out, all that make a difference."""
        return range(1, max(most, 1) + 1 if self.skips else 2)

    def order(self, groups: Sequence[tuple[str, Sequence[int]]]) -> list[DueTurn]:
        """Let all machines have a turn, one after the other."""
        return _one_after_the_other(groups)

    def begin_ns(self, rounds: int) -> int:
        """Return the time of so many periods, as the first round begins after one."""
        return rounds * self.unit_ns


class Slots(Periods):
    """Turns are due as in a timetable.

    Each of the machines `watching` has a turn whenever one is due, behind all others.
    """

    def __init__(self, timetable: Timetable, *, watching: Iterable[str] = ()):
        starts = {slot.start_us: None for slot in timetable.slots}
        cycle_us = timetable.cycle_us
        whenever = [TimeSlot(name, start, cycle_us) for start in starts for name in watching]
        slots = sorted((*timetable.slots, *whenever), key=lambda slot: slot.start_us)
        self.timetable = Timetable(slots, cycle_us)
        """The timetable of all machines."""
        begin_us = slots[0].start_us
        unit_us = gcd(cycle_us, *(slot.start_us - begin_us for slot in slots))
        super().__init__(unit_us * 1_000)
        first_us = slots[-1].start_us - cycle_us
        gaps_us = [begin_us - first_us, *(b.start_us - a.start_us for a, b in pairwise(slots))]
        self._units = [gap_us // unit_us for gap_us in gaps_us]
        self._turns = len(timetable.slots)

    @property
    def schedule(self) -> str:
        """The number of turns and the cycle."""
        return f"a timetable of {self._turns} turns every {self.timetable.cycle_us / 1e3:g} ms"

    @property
    def not_covered(self) -> str:
        """Cycles that are left out."""
        return "cycles that a run leaves out when it is over a second behind"

    def order(self, groups: Sequence[tuple[str, Sequence[int]]]) -> list[DueTurn]:
        """List the turns of a cycle; those of inner machines follow that of their outer one."""
        places = dict(groups)
        for name in places:
            self.timetable.check_has(name)
        order, units = [], 0
        for slot, passing in zip(self.timetable.slots, self._units, strict=True):
            units += passing
            for place in places.get(slot.machine, ()):
                order.append(DueTurn(place, units, slot.start_us * 1_000))
                units = 0
        return [order[0]._replace(units=order[0].units + units), *order[1:]]

    def begin_ns(self, rounds: int) -> int:
        """Return the time of the cycles before, as the first begins at once."""
        return (rounds - 1) * self.timetable.cycle_us * 1_000


class AnyTime:
    """Any time may pass before a round, also none."""

    unit_ns = None
    schedule = "any time between rounds"
    not_covered = "time that passes within a round"

    def most(self, limits: Limits) -> int:
        """Return the number of limits."""
        return len(limits)

    def elapsed_ns(self, number: int, limits: Limits) -> int:
        """Return the shortest time after which so many limits are over."""
        return limits[number - 1] + 1 if number else 0

    def steps(self, number: int, limits: Limits, units: int) -> tuple[int, ...]:
        """List all numbers of further limits that may be over by then."""
        return tuple(range(len(limits) - number + 1))

    def rounds(self, most: int) -> range:
        """List 1: any time passes before the next round."""
        return range(1, 2)

    def order(self, groups: Sequence[tuple[str, Sequence[int]]]) -> list[DueTurn]:
        """Let all machines have a turn, one after the other."""
        return _one_after_the_other(groups)

    def begin_ns(self, rounds: int) -> int:
        """Return 0: the times of rounds follow from what the way to them needs."""
        return 0


def timetable_of(time_model: TimeModel) -> Timetable | None:
    """Return the timetable of all machines; None for another schedule."""
    return time_model.timetable if isinstance(time_model, Slots) else None
