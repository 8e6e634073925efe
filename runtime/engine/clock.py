"""Where time comes from: a clock is passed in, and nothing else in the engine reads time."""

from __future__ import annotations

import time
from typing import Protocol

from .errors import ClockError

__all__ = ["Clock", "ManualClock", "MonotonicClock"]


class Clock(Protocol):
    """What the runtime needs of time. Whole nanoseconds from any fixed start, never going back.

    They are less than 2**63: what that means is that they last for 292 years.
    """

    def now_ns(self) -> int:
        """Return the time."""
        ...

    def sleep_until_ns(self, deadline_ns: int) -> None:
        """Return when it is `deadline_ns` or later; at once if it already is."""
        ...


class MonotonicClock:
    """The host's CLOCK_MONOTONIC, which no adjustment of the date moves."""

    now_ns = staticmethod(time.monotonic_ns)

    def sleep_until_ns(self, deadline_ns: int) -> None:
        """Block the thread until `deadline_ns`."""
        left = deadline_ns - time.monotonic_ns()
        if left > 0:
            time.sleep(left / 1e9)  # this is what a clock's sleep is


class ManualClock:
    """Stand still until `advance` is called: time for tests and simulation. Sleeping moves it."""

    def __init__(self, start_ns: int = 0):
        self._now_ns = start_ns

    def now_ns(self) -> int:
        """Return the time."""
        return self._now_ns

    def sleep_until_ns(self, deadline_ns: int) -> None:
        """Be at `deadline_ns` at once, if that is ahead."""
        self._now_ns = max(self._now_ns, deadline_ns)

    def advance(self, *, s: float = 0, ms: float = 0, us: float = 0, ns: int = 0) -> None:
        """Move ahead by the sum of the given times; a negative sum raises `ClockError`."""
        step = round(s * 1e9) + round(ms * 1e6) + round(us * 1e3) + ns
        if step < 0:
            raise ClockError(f"a clock cannot go back by {-step} ns")
        self._now_ns += step
