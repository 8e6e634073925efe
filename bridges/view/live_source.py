"""A live board as a page's source."""

from __future__ import annotations

import os
import time
from collections.abc import Mapping, Sequence

from llfsm.runtime.presence.remote import is_live
from llfsm.whiteboard import BoardNotFoundError, Message, Sample, Whiteboard
from llfsm.whiteboard.board import SlotInfo
from llfsm.whiteboard.messages.llfsm import VIEWER, MachineStatus, Viewer
from llfsm.whiteboard.poller import BoardPoller

from .page_source import Change, PageSource, Snapshot
from .state_history import StateHistory

__all__ = ["LiveSource"]

_OPEN_NS = 300_000_000  # between two attempts to open a board that is not there
_DISCOVERY_S = 0.4  # between two searches for new slots
_VIEW_NS = 500_000_000  # between two messages that the variables are viewed


class LiveSource(PageSource):
    """Poll the board of a name; the board may be removed and made again."""

    def __init__(self, name: str) -> None:
        self.title = name
        self._board: Whiteboard | None = None
        self._poller: BoardPoller | None = None
        self._slots: dict[str, SlotInfo] = {}
        self._epoch = 0
        self._trouble = ""
        self._open_ns = self._view_ns = 0  # when that is due
        self._history = StateHistory()

    def snapshot(self) -> Snapshot:
        """Return the state of everything; never raise because of what a board holds."""
        now_ns = time.monotonic_ns()
        samples: dict[str, Sample[Message]] = {}
        problems: dict[str, str] = {}
        try:
            self._open(now_ns)
            if self._board is not None and self._poller is not None:
                self._poller.poll()
                slots = self._poller.slots
                samples = {n: each.sample for n, each in slots.items() if each.sample is not None}
                problems = {n: each.problem for n, each in slots.items() if each.problem}
                if len(slots) > len(self._slots):
                    self._slots = {name: each.info for name, each in slots.items()}
                if now_ns >= self._view_ns:
                    self._view_ns = now_ns + _VIEW_NS
                    self._board.add_message(VIEWER, Viewer(os.getpid()))
        except Exception as error:  # also what a damaged file makes of the libraries that read it
            self._trouble = f"the whiteboard cannot be read: {error}; trying again"
            self.close()
        if self._board is not None:
            self._trouble = ""
            self._history.add(samples, now_ns, self.is_live)
        return Snapshot(now_ns, self._epoch, self._slots, samples, problems, self._trouble)

    def is_live(self, sample: Sample[MachineStatus]) -> bool:
        """Return whether a machine is loaded by a process that lives."""
        return is_live(sample)

    def history(self) -> Mapping[str, Sequence[Change]]:
        """Return the states in which each machine was seen."""
        return self._history.changes

    def board(self) -> Whiteboard | None:
        """Return the board, or None while it does not exist."""
        return self._board

    def close(self) -> None:
        """Close the board."""
        if self._board is not None:
            self._board.close()
            self._board = self._poller = None
            self._slots = {}

    def _open(self, now_ns: int) -> None:
        if self._board is not None and not self._board.alive:
            self._trouble = f"the whiteboard {self.title!r} was removed; waiting for a new one"
            self.close()
        if self._board is None and now_ns >= self._open_ns:
            self._open_ns = now_ns + _OPEN_NS
            try:
                self._board = Whiteboard(self.title, create=False)
            except BoardNotFoundError:
                self._trouble = self._trouble or (
                    f"there is no whiteboard {self.title!r} yet; it appears here as soon as "
                    f"something runs on it, for example: llfsm demo wall --board {self.title}"
                )
                return
            self._poller = BoardPoller(self._board, discovery_s=_DISCOVERY_S)
            self._epoch += 1
            self._history = StateHistory()
            self._view_ns = 0
