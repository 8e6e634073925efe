"""Messages and connections that were refused: each kind is counted, and logged once."""

from __future__ import annotations

import logging
from collections import Counter

from ..messages.llfsm import Refusal

__all__ = ["Refusals", "Refused"]

_MAX_KINDS = 200  # a sender can cause any number
_MAX_LENGTH = 400  # characters of a log message

_log = logging.getLogger("llfsm.mirror")


class Refused(Exception):  # noqa: N818  not for users: it is counted and logged
    """Raised when a message cannot enter the board; the text gives the reason."""


class Refusals:
    """Counts refusals by their kind, and logs the first of each kind."""

    def __init__(self) -> None:
        self._counts: Counter[str] = Counter()

    def add(self, kind: str, reason: str) -> None:
        """Count a refusal under `kind`; `reason` is logged for the first one."""
        if kind not in self._counts and len(self._counts) >= _MAX_KINDS:
            kind = reason = "everything else"
        self._counts[kind] += 1
        if self._counts[kind] == 1:
            _log.warning("refused: %s", reason[:_MAX_LENGTH])

    def report(self) -> tuple[Refusal, ...]:
        """Return all refusals, the most frequent first."""
        return tuple(Refusal(kind, count) for kind, count in self._counts.most_common())
