"""Clocks. One is passed into an arrangement, and nothing else in the engine reads time."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from typing import Final, Literal

from llfsm.runtime.engine.errors import ClockError

NEVER: Final = -(2**63)
"""Instead of a time or a duration in nanoseconds: there has been none, or none is planned."""
FOREVER: Final = 2**63 - 1
"""A time in nanoseconds that no clock reaches."""


class Clock:
    """The time of an arrangement, in whole nanoseconds from any fixed start, never going back.

    Times are less than 2**63, which is 292 years. A clock of your own has `now_ns` and
    `sleep_until_ns`; the rest says how it goes, and is right for one that only sleeping moves.
    """

    passes: bool = False
    """It passes by itself, as the host's does: news may end a sleep early."""
    stamps: bool = False
    """It is the clock of the messages' stamps, so their ages are known exactly."""
    nap_s: float | None = None
    """Another program sets it: a sleep ends after so many seconds of the host, to look again."""
    behind_ns: int | None = None
    """How far it is behind the host's clock, if pauses stop it."""
    while_paused: Literal["runs", "stands", "simulated"] = "runs"
    """Its time while a debugger has paused the machines."""

    def now_ns(self) -> int:
        """Return the time."""
        raise NotImplementedError

    def sleep_until_ns(self, deadline_ns: int, /) -> None:
        """Sleep until `deadline_ns`; return at once if it is that late.

        A clock that may stand still also returns earlier: callers look at it again.
        """
        raise NotImplementedError

    def listen(self, changed: Callable[[], None]) -> None:
        """Call `changed` whenever another program has set the time."""

    def run_on(self) -> None:
        """Pass with the host's time from now on: no pause of a simulation delays a stop."""

    def stopped(self) -> AbstractContextManager[None]:
        """Stand still within a ``with`` block, if pauses stop this clock."""
        return nullcontext()

    def of_messages(self) -> Clock:
        """Return the clock by which messages age: the world does not wait for a debugger."""
        return self

    def of_statuses(self) -> Clock:
        """Return the clock by which to publish for other processes: none that may stand still."""
        return self


try:
    from llfsm.runtime.engine._ringlet import sleep_until_ns as _sleep_until_ns
except ImportError:

    def _sleep_until_ns(deadline_ns: int, /) -> None:
        # It ends later than it should by what is done between the two looks at the clock.
        left = deadline_ns - time.monotonic_ns()
        if left > 0:
            time.sleep(left / 1e9)  # this is what a clock's sleep is


class MonotonicClock(Clock):
    """The host's CLOCK_MONOTONIC, which no adjustment of the date moves.

    Sleeping blocks the thread; a handler of a signal runs meanwhile, and ends it if it raises.
    """

    passes = stamps = True
    now_ns = staticmethod(time.monotonic_ns)
    sleep_until_ns = staticmethod(_sleep_until_ns)


class DebugClock(Clock):
    """The host's CLOCK_MONOTONIC without the time for which it was stopped: it goes on from there.

    The ages of sensors' messages are not by this clock: the world does not wait.
    """

    passes = True
    while_paused = "stands"
    behind_ns: int

    def __init__(self) -> None:
        self.behind_ns = 0
        self._stopped_ns: int | None = None

    def now_ns(self) -> int:
        """Return the time."""
        host_ns = time.monotonic_ns() if self._stopped_ns is None else self._stopped_ns
        return host_ns - self.behind_ns

    def sleep_until_ns(self, deadline_ns: int) -> None:
        """Sleep until `deadline_ns`; the clock must not be stopped."""
        _sleep_until_ns(deadline_ns + self.behind_ns)

    @contextmanager
    def stopped(self) -> Iterator[None]:
        """Stand still meanwhile."""
        self._stopped_ns = time.monotonic_ns()
        try:
            yield
        finally:
            self.behind_ns += time.monotonic_ns() - self._stopped_ns
            self._stopped_ns = None

    def of_messages(self) -> Clock:
        """Return the host's clock."""
        return MonotonicClock()

    of_statuses = of_messages


class ManualClock(Clock):
    """Stand still until `advance` is called: time for tests and simulation. Sleeping moves it."""

    while_paused = "stands"

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


class SimulatedClock(Clock):
    """Time that another program sets, as a simulator or a player of recordings does.

    It stands still between two calls of `set_ns`, and begins with the time of the first one. Where
    that program jumps ahead, so does the clock; where it jumps back, the clock stands still, and
    goes on from there. Any thread may set it.
    """

    nap_s: float = 0.02
    while_paused = "simulated"

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._source_ns: int | None = None  # what it was set to last
        self._ahead_ns = 0  # of the source, by all of its jumps back
        self._now_ns = 0
        self._ahead_of_host_ns: int | None = None  # once it passes with the host's
        self._listeners: list[Callable[[], None]] = []

    def set_ns(self, time_ns: int) -> None:
        """Set the time of the source, in nanoseconds from any fixed start."""
        with self._changed:
            if self._source_ns is not None:
                self._ahead_ns += max(self._source_ns - time_ns, 0)
            self._source_ns = time_ns
            self._now_ns = time_ns + self._ahead_ns
            self._changed.notify_all()
        for changed in self._listeners:
            changed()

    def run_on(self) -> None:
        """Pass with the host's time from now on, whatever is set."""
        with self._changed:
            if self._ahead_of_host_ns is None:
                self._ahead_of_host_ns = self._now_ns - time.monotonic_ns()
            self._changed.notify_all()

    def listen(self, changed: Callable[[], None]) -> None:
        """Call `changed` after each `set_ns`, on its thread."""
        self._listeners.append(changed)

    def wait_set(self, timeout_s: float) -> bool:
        """Wait until it was set once; return False if it was not within `timeout_s` seconds."""
        with self._changed:
            return self._changed.wait_for(lambda: self._source_ns is not None, timeout_s)

    def now_ns(self) -> int:
        """Return the time."""
        ahead_ns = self._ahead_of_host_ns
        return self._now_ns if ahead_ns is None else time.monotonic_ns() + ahead_ns

    def sleep_until_ns(self, deadline_ns: int) -> None:
        """Sleep until `deadline_ns`, for at most `nap_s` seconds of the host."""
        with self._changed:
            self._changed.wait_for(lambda: self.now_ns() >= deadline_ns, self.nap_s)

    def of_statuses(self) -> Clock:
        """Return the host's clock."""
        return MonotonicClock()
