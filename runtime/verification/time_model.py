"""How time passes between rounds: exactly a period, or any time.

The time in a state is a small number: of periods that have passed, or of limits that are over.

When an exploration must end, wherever it is then.
"""

from __future__ import annotations

import time
from bisect import insort
from math import inf
from typing import Protocol


class TimeUpError(Exception):
    """The time to explore is over."""


ENDINGS = (KeyboardInterrupt, TimeUpError)
"""What ends an exploration: what is not known by then is undecided."""


class Deadline:
    """A time after which no more ringlets are run; none at first."""

    def __init__(self) -> None:
        self.at_s = inf
        """By `time.monotonic()`."""

    def check(self) -> None:
        """Raise `TimeUpError` if it has passed."""
        if time.monotonic() >= self.at_s:
            raise TimeUpError


class Limits(list[int]):
    """The times that are asked about in a state, in nanoseconds and in order."""

    def note(self, limit_ns: int) -> None:
        """Add a time if it is not known."""
        if limit_ns not in self:
            insort(self, limit_ns)


class Passing(Protocol):
    """How time passes."""

    def most(self, limits: Limits) -> int:
        """Return the largest number for the time in a state with these limits."""
        ...

    def elapsed_ns(self, number: int, limits: Limits) -> int:
        """Return a time in the state, in nanoseconds, for which a number stands."""
        ...

    def steps(self, number: int, limits: Limits) -> tuple[int, ...]:
        """Return by how much the number may grow before a round."""
        ...


class Periods:
    """Each round begins a period after the one before."""

    def __init__(self, period_ns: int):
        self.period_ns = period_ns

    def most(self, limits: Limits) -> int:
        """Return after how many periods all times are over."""
        return limits[-1] // self.period_ns + 1 if limits else 0

    def elapsed_ns(self, number: int, limits: Limits) -> int:
        """Return the time of so many periods."""
        return number * self.period_ns

    def steps(self, number: int, limits: Limits) -> tuple[int, ...]:
        """Return 1, until all times are over."""
        return (1,) if number < self.most(limits) else (0,)


class AnyTime:
    """Any time may pass before a round, also none."""

    def most(self, limits: Limits) -> int:
        """Return the number of limits."""
        return len(limits)

    def elapsed_ns(self, number: int, limits: Limits) -> int:
        """Return the shortest time after which so many limits are over."""
        return limits[number - 1] + 1 if number else 0

    def steps(self, number: int, limits: Limits) -> tuple[int, ...]:
        """Return all numbers of limits that may be over by then."""
        return tuple(range(len(limits) - number + 1))
