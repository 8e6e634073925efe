"""Leases: what another process has requested, a pause or an override, ends when nobody renews it.

So no robot stands still, or reads a sensor that is not its own, because a page was closed or a
connection lost. Leases are counted on the host's clock, as machines' clocks may stand still.
"""

from __future__ import annotations

import time
from typing import Final

LEASE_S: Final = 60.0
"""Seconds that a pause or an override by a command lasts, and a pause at a breakpoint of a run."""
PAGE_LEASE_S: Final = 6.0
"""Seconds that one by a page lasts, which renews it each second as long as the page is open."""


class Lease:
    """A time from now on, in seconds, which can be renewed until it is over, and after."""

    def __init__(self, lasts_s: float):
        self._ends_s = time.monotonic() + lasts_s

    def renew(self, lasts_s: float) -> None:
        """Let it last at least so long from now on; another one's renewal shortens none."""
        self._ends_s = max(self._ends_s, time.monotonic() + lasts_s)

    @property
    def left_s(self) -> float:
        """The seconds until it is over; 0 if it is."""
        return max(0.0, self._ends_s - time.monotonic())

    @property
    def is_over(self) -> bool:
        """True if nobody has renewed it in time."""
        return time.monotonic() > self._ends_s
