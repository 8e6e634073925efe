"""The route of one slot between the board and the other hosts: its directions and its rate."""

from __future__ import annotations

from .merge import Version
from .store import Cell

__all__ = ["RateLimit", "Route"]

_EARLY_NS = 5_000_000
_BURST = 2  # arrivals may come at this multiple of the slot's rate; more are held back


class RateLimit:
    """When the next message may pass.

    One message may pass each period, up to 5 ms early if the previous one was not: the generic cell
    rate algorithm of ITU-T I.371. So messages that come at the permitted rate, but with jitter, do
    not wait each time.

    Args:
        period_ns: nanoseconds from one message to the next.

    """

    __slots__ = ("_least_ns", "_period_ns", "due_ns")

    def __init__(self, period_ns: int) -> None:
        self._period_ns = period_ns
        self._least_ns = max(0, period_ns - _EARLY_NS)
        self.due_ns = 0
        """When the next message may pass."""

    def record(self, now_ns: int) -> None:
        """Record that a message passes now."""
        self.due_ns = max(self.due_ns + self._period_ns, now_ns + self._least_ns)


class Route:
    """Whether and when messages of a slot leave the board and enter it."""

    __slots__ = ("arrivals", "cell", "departures", "enters", "leaves", "sent")

    def __init__(self, cell: Cell, leaves: bool, enters: bool, period_ns: int) -> None:
        self.cell = cell
        self.leaves = leaves
        self.enters = enters
        self.departures = RateLimit(period_ns)
        self.arrivals = RateLimit(period_ns // _BURST)
        self.sent: Version | None = None
