"""The time models: how much time passes between two rounds, a period, several, or any time.

In a run with a period machines see when their turn was due, which is a whole number of periods
after any other turn. More than one passes if a run is so far behind that it leaves rounds out.

Of the time for which a machine has been in its state, only the answers to the questions that its
code asks matter: is it longer than this limit? So the time in a state is a small number. With a
period it counts the periods that have passed, up to the first at which all limits are over; with
any time it counts the limits that are over. The limits are learnt as ringlets ask about them.
"""

from __future__ import annotations

from bisect import insort
from typing import Protocol


class Limits(list[int]):
    """The times that code asks about in a state, in nanoseconds and in order."""

    def note(self, limit_ns: int) -> None:
        """Add a time if it is new."""
        if limit_ns not in self:
            insort(self, limit_ns)


class TimeModel(Protocol):
    """A rule of how much time passes between two rounds, by numbers for the time in a state."""

    @property
    def period_ns(self) -> int | None:
        """The time from one round to the next, in nanoseconds; None if it may be any."""

    @property
    def schedule(self) -> str:
        """The schedule of the runs that are explored, in words."""

    @property
    def not_covered(self) -> str:
        """What runs with this schedule may do that is not explored; "" if there is nothing."""

    def most(self, limits: Limits) -> int:
        """Return the largest number for the time in a state with these limits."""
        ...

    def elapsed_ns(self, number: int, limits: Limits) -> int:
        """Return the least time in the state, in nanoseconds, for which a number stands."""
        ...

    def steps(self, number: int, limits: Limits, rounds: int) -> tuple[int, ...]:
        """List by how much the number may grow before a round, `rounds` after the one before."""
        ...

    def rounds(self, most: int) -> range:
        """List how many rounds after the one before a round may begin, up to `most`."""
        ...


class Periods:
    """Each round begins a period after the one before; with `skips`, any number of periods."""

    def __init__(self, period_ns: int, *, skips: bool = False):
        self.period_ns = period_ns
        self.skips = skips

    @property
    def schedule(self) -> str:
        """The period, and whether rounds may be left out."""
        left_out = ", of which any number may be left out" if self.skips else ""
        return f"a round every {self.period_ns / 1e6:g} ms{left_out}"

    @property
    def not_covered(self) -> str:
        """Rounds that are left out, unless they are explored."""
        behind = "rounds that a run leaves out when it is over a second behind"
        return "" if self.skips else f"{behind} (--skips, skips=True)"

    def most(self, limits: Limits) -> int:
        """Return after how many periods all limits are over."""
        return limits[-1] // self.period_ns + 1 if limits else 0

    def elapsed_ns(self, number: int, limits: Limits) -> int:
        """Return the time of so many periods."""
        return number * self.period_ns

    def steps(self, number: int, limits: Limits, rounds: int) -> tuple[int, ...]:
        """Return the number of periods, until all limits are over."""
        return (min(rounds, self.most(limits) - number),)

    def rounds(self, most: int) -> range:
        """List 1 or, if rounds may be left out, all that make a difference."""
        return range(1, max(most, 1) + 1 if self.skips else 2)


class AnyTime:
    """Any time may pass before a round, also none."""

    period_ns = None
    schedule = "any time between rounds"
    not_covered = "time that passes within a round"

    def most(self, limits: Limits) -> int:
        """Return the number of limits."""
        return len(limits)

    def elapsed_ns(self, number: int, limits: Limits) -> int:
        """Return the shortest time after which so many limits are over."""
        return limits[number - 1] + 1 if number else 0

    def steps(self, number: int, limits: Limits, rounds: int) -> tuple[int, ...]:
        """List all numbers of further limits that may be over by then."""
        return tuple(range(len(limits) - number + 1))

    def rounds(self, most: int) -> range:
        """List 1: any time passes before the next round."""
        return range(1, 2)
