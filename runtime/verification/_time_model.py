"""The time models: how much time passes between two rounds, exactly a period or any time.

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

    def most(self, limits: Limits) -> int:
        """Return the largest number for the time in a state with these limits."""
        ...

    def elapsed_ns(self, number: int, limits: Limits) -> int:
        """Return the least time in the state, in nanoseconds, for which a number stands."""
        ...

    def steps(self, number: int, limits: Limits) -> tuple[int, ...]:
        """List by how much the number may grow before a round."""
        ...


class Periods:
    """Each round begins a period after the one before."""

    def __init__(self, period_ns: int):
        self.period_ns = period_ns

    def most(self, limits: Limits) -> int:
        """Return after how many periods all limits are over."""
        return limits[-1] // self.period_ns + 1 if limits else 0

    def elapsed_ns(self, number: int, limits: Limits) -> int:
        """Return the time of so many periods."""
        return number * self.period_ns

    def steps(self, number: int, limits: Limits) -> tuple[int, ...]:
        """Return 1, until all limits are over."""
        return (1,) if number < self.most(limits) else (0,)


class AnyTime:
    """Any time may pass before a round, also none."""

    period_ns = None

    def most(self, limits: Limits) -> int:
        """Return the number of limits."""
        return len(limits)

    def elapsed_ns(self, number: int, limits: Limits) -> int:
        """Return the shortest time after which so many limits are over."""
        return limits[number - 1] + 1 if number else 0

    def steps(self, number: int, limits: Limits) -> tuple[int, ...]:
        """List all numbers of further limits that may be over by then."""
        return tuple(range(len(limits) - number + 1))
