"""How often something may pass: at its rate, and a little before its time."""

from __future__ import annotations

__all__ = ["Pace"]

_EARLY_NS = 5_000_000


class Pace:
    """When the next message may pass.

    One may every pause, and up to 5 ms early if the one before it was not: the generic cell rate
    algorithm of ITU-T I.371. So what comes as often as it may, but never quite on time, does not
    wait each time.

    Args:
        pause_ns: nanoseconds from one to the next.

    """

    __slots__ = ("_least_ns", "_pause_ns", "due_ns")

    def __init__(self, pause_ns: int) -> None:
        self._pause_ns = pause_ns
        self._least_ns = max(0, pause_ns - _EARLY_NS)
        self.due_ns = 0
        """When the next one may pass."""

    def passed(self, now_ns: int) -> None:
        """Take note that one passes."""
        self.due_ns = max(self.due_ns + self._pause_ns, now_ns + self._least_ns)
