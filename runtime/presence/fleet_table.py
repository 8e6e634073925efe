"""The hosts of a fleet as a table, for as long as somebody looks at it.

It reads which hosts there are, and the summary that each publishes, and nothing else of theirs.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterator
from contextlib import suppress
from typing import Literal, NamedTuple, Self, TypeAlias

from llfsm.whiteboard import Board, Sample, Slot, WhiteboardError
from llfsm.whiteboard.messages.fleet import HOSTS, SUMMARIES, HostSummary, summary_slot

from .hosts import NO_DAEMON, HostNames

__all__ = ["FleetTable", "HostRow", "Trouble"]

Trouble: TypeAlias = Literal["lost", "failed", "clock", ""]
"""What is worst about a host: it is silent, a machine is in trouble, its clock is wrong; or ""."""

_WRONG_CLOCK_S = 1.0
_LEADS = 10  # summaries from which a clock's lead is estimated


class HostRow(NamedTuple):
    """What is known of a host."""

    name: str
    is_own: bool
    """Whether it is this host."""
    is_there: bool
    """Whether it can be reached."""
    contact_ns: int | None
    """When its latest summary arrived, by the monotonic clock; None before the first."""
    lead_s: float | None
    """How far its clock is ahead of this host's, or a little less: as much as messages take."""
    summary: HostSummary | None
    trouble: Trouble


class _Known:
    """What was received of a host."""

    def __init__(self) -> None:
        self.is_there = True
        self.begun_ns = time.monotonic_ns()  # before, it may have travelled to nobody here
        self.sample: Sample[HostSummary] | None = None
        self._leads_s: deque[float] = deque(maxlen=_LEADS)

    def take(self, sample: Sample[HostSummary] | None, ahead_ns: int) -> None:
        """Take the latest summary, which may be the one before."""
        if sample is None or (self.sample is not None and sample.count == self.sample.count):
            return
        if self.sample is not None:  # the first may be an old one, which was asked for
            self._leads_s.append((sample.message.sent_ns - sample.stamp_ns - ahead_ns) / 1e9)
        self.sample = sample

    @property
    def lead_s(self) -> float | None:
        """The largest of the last leads: its message was the fastest."""
        return max(self._leads_s, default=None)


class FleetTable:
    """The hosts that can be reached, or have been, until the end of a ``with``.

    What a host has published stays on the board, so those that were seen before are known.

    Args:
        board: of this host.
        silent_s: a host whose summary is older is lost. They are published once a second.

    """

    def __init__(self, board: Board, *, silent_s: float = 3.0) -> None:
        self._board = board
        self._silent_ns = silent_s * 1e9
        self._names = HostNames(board)
        self._known: dict[str, _Known] = {}

    def __enter__(self) -> Self:
        self.look()
        return self

    def __exit__(self, *_: object) -> None:
        self._board.forget(HOSTS)
        for name in self._known:
            self._board.forget(self._slot(name))

    def look(self) -> None:
        """Read what has arrived since; call it a few times a second."""
        names = HostNames(self._board)
        if names.own != self._names.own:  # another daemon: this host's own slot is another one
            self.__exit__()
            self._known = {}
        self._names = names
        ahead_ns = time.time_ns() - time.monotonic_ns()
        with suppress(WhiteboardError):  # no room for a slot: then what is there is all
            hosts = names.reached(self._board)
            for name in (*hosts, *self._seen()):
                self._known.setdefault(name, _Known())
            for name, known in self._known.items():
                known.is_there = name in hosts
                known.take(self._board[self._slot(name)].sample(), ahead_ns)

    def _seen(self) -> Iterator[str]:
        """Return the hosts whose summaries are on the board."""
        for info in self._board.slots():
            if info.name.startswith(SUMMARIES):
                name = info.name.removeprefix(SUMMARIES).strip("/")
                if name != self._names.own and self._names.is_known(name):
                    yield name

    def rows(self) -> list[HostRow]:
        """Return a row for each host, by name."""
        now_ns = time.monotonic_ns()
        return [self._row(name, self._known[name], now_ns) for name in sorted(self._known)]

    def problem(self) -> str:
        """Return why there is nothing to show, and what to do; empty if there is nothing wrong."""
        return "" if self._names.is_mirrored else NO_DAEMON

    def _slot(self, name: str) -> Slot[HostSummary]:
        return summary_slot("" if name == self._names.own else name)

    def _row(self, name: str, known: _Known, now_ns: int) -> HostRow:
        sample, lead_s = known.sample, known.lead_s
        trouble: Trouble = ""
        is_silent = (
            sample is not None and now_ns - max(sample.stamp_ns, known.begun_ns) > self._silent_ns
        )
        if not known.is_there or is_silent:
            trouble = "lost"
        elif sample is not None and sample.message.troubled:
            trouble = "failed"
        elif lead_s is not None and abs(lead_s) > _WRONG_CLOCK_S:
            trouble = "clock"
        return HostRow(
            name,
            name == self._names.own,
            known.is_there,
            None if sample is None else sample.stamp_ns,
            lead_s,
            None if sample is None else sample.message,
            trouble,
        )
