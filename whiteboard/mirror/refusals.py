"""What was refused: each thing counted, and reported once."""

from __future__ import annotations

import logging
from collections import Counter

from ..messages.llfsm import Refusal

__all__ = ["Refusals", "logger"]

_MOST = 200  # kinds of refusals told apart; a sender can think of any number
_SHOWN = 400  # characters of a report

logger = logging.getLogger("llfsm.mirror")


class Refusals:
    """Count refusals by what they are about, and log the first of each."""

    def __init__(self) -> None:
        self._counts: Counter[str] = Counter()

    def add(self, about: str, why: str) -> None:
        """Count one; `about` is what it is counted under, `why` is what is reported."""
        if about not in self._counts and len(self._counts) >= _MOST:
            about = why = "everything else"
        self._counts[about] += 1
        if self._counts[about] == 1:
            logger.warning("refused: %s", why[:_SHOWN])

    def report(self) -> tuple[Refusal, ...]:
        """Return all, the most frequent first."""
        return tuple(Refusal(what, count) for what, count in self._counts.most_common())
