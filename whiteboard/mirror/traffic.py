"""What a host sends and receives, and how much of it in a second."""

from __future__ import annotations

from typing import NamedTuple

__all__ = ["Rates", "Traffic"]


class Rates(NamedTuple):
    """What one second has brought, on average since the rates before."""

    left: float
    """Messages of slots."""
    entered: float
    sent: float
    """Bytes."""
    received: float


class Traffic:
    """Counts what leaves and what comes; not what Zenoh and the network add to it.

    A batch counts once, however many hosts read it: they share it as far as a router forwards it.
    """

    def __init__(self, now_ns: int) -> None:
        self.left = 0
        """Messages of slots that were sent."""
        self.sent = self.received = 0
        """Bytes of all kinds of messages between hosts."""
        self._before = (0, 0, 0, 0)
        self._before_ns = now_ns

    def rates(self, entered: int, now_ns: int) -> Rates:
        """Return the rates since the last call; so many messages of slots have `entered` so far."""
        counts = (self.left, entered, self.sent, self.received)
        seconds = max((now_ns - self._before_ns) / 1e9, 1e-9)
        grown = (now - before for now, before in zip(counts, self._before, strict=True))
        self._before, self._before_ns = counts, now_ns
        return Rates(*(round(each / seconds, 1) for each in grown))
