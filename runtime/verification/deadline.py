"""When an exploration must end, wherever it is then."""

from __future__ import annotations

import time
from math import inf

__all__ = ["ENDINGS", "Deadline", "TimeUpError"]


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
