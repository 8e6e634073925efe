"""What a link between the board and ROS has done so far."""

from __future__ import annotations

import time

__all__ = ["Link"]


class Link:
    """One direction of a relay, or a service: who is connected, and how much went through.

    Each is counted up by one thread; any may read it.
    """

    def __init__(self, slot: str, arrow: str, name: str, type_name: str) -> None:
        self.slot = slot
        self.arrow = arrow
        self.name = name
        """The topic's or service's full name."""
        self.type_name = type_name
        self.passed = 0
        """Messages, or answered requests."""
        self.failed = 0
        """Those that could not be passed on, or were not answered."""
        self._last: float | None = None

    def __str__(self) -> str:
        return f"{self.slot} {self.arrow} {self.name}"

    def count(self) -> None:
        """Count one that went through, now."""
        self.passed += 1
        self._last = time.monotonic()

    @property
    def age(self) -> float | None:
        """Seconds since the last one went through, or None before the first."""
        last = self._last
        return None if last is None else time.monotonic() - last
