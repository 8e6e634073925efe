"""How old the messages of sensors are, by an arrangement's clock, and which are too old.

The host's monotonic clock is that of the messages' stamps. With any other clock, a message of a
board in this process is as old as the time since it was added, exactly; one that another process
has added is as old as the time since the sensor first found it.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Protocol

from llfsm.runtime.engine.clock import DebugClock, MonotonicClock

if TYPE_CHECKING:
    from collections.abc import Callable

    from llfsm.runtime.engine.clock import Clock
    from llfsm.runtime.engine.ports import Sensor
    from llfsm.whiteboard import BoundSlot, Sample


class AgedRead(Protocol):
    """What reads a sensor and knows the age of what it has read."""

    start_count: int
    """The slot's count when the machine was loaded."""

    def __call__(self) -> object:
        """Return the latest message; None if there is none or it is too old."""
        ...

    def age_ns(self) -> int | None:
        """Return how old the message is that was read last; None if there was none."""
        ...


class OverriddenSlot:
    """A slot as a machine reads it for which it is overridden: its message is new at each look.

    `message` is None if there is to be none; `count` is the slot's own, from which it counts on.
    """

    def __init__(self, message: Any, count: int):
        self._message = message
        self.count = count

    def get(self) -> Any:
        """Return the message."""
        return self._message

    def sample(self) -> Sample[Any] | None:
        """Return the message with the stamp of this moment."""
        from llfsm.whiteboard import Sample  # here, as few override

        if self._message is None:
            return None
        self.count += 1
        return Sample(self._message, self.count, MonotonicClock().now_ns(), 0)

    def on_add(self, callback: Callable[[int], None]) -> None:
        """Call nothing: no message is added here."""


class BoardAgedRead:
    """Read a sensor from a slot of a board.

    `start_count` is the slot's count when the machine was loaded; by default that is now.
    """

    def __init__(
        self,
        sensor: Sensor[Any, Any],
        bound: BoundSlot[Any] | OverriddenSlot,
        clock: Clock,
        start_count: int | None = None,
    ):
        self.start_count = bound.count if start_count is None else start_count
        self._bound = bound
        self._first = self.start_count if sensor.since_start else 0
        limit_ms = math.inf if sensor.max_age_ms is None else sensor.max_age_ms
        self._limit_ns = limit_ms * 1e6
        if isinstance(clock, DebugClock):  # the world does not wait
            clock = MonotonicClock()
        self._now = clock.now_ns
        self._stamped = isinstance(clock, MonotonicClock)
        self._added: tuple[int, int] | None = None  # count of the latest message, and when it came
        self._read_ns: int | None = None  # when the message that was read last was added
        if not self._stamped:
            self._note(bound.count)
            bound.on_add(self._note)

    def __call__(self) -> object:
        """Return the latest message; None if there is none or it is too old."""
        sample = self._bound.sample()
        if sample is None:
            return None
        if self._stamped:
            self._read_ns = sample.stamp_ns
        else:
            if self._added is None or self._added[0] != sample.count:  # from another process
                self._note(sample.count)
            assert self._added is not None
            self._read_ns = self._added[1]
        if sample.count <= self._first or self._now() - self._read_ns > self._limit_ns:
            return None
        return sample.message

    def age_ns(self) -> int | None:
        """Return how old the message is that was read last; None if there was none."""
        return None if self._read_ns is None else self._now() - self._read_ns

    def _note(self, count: int) -> None:
        self._added = count, self._now()
