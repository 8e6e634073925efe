"""A live board as a page's source."""

from __future__ import annotations

import os
import time
from collections.abc import Mapping, Sequence

from llfsm.runtime.presence.remote import is_live
from llfsm.whiteboard import (
    BoardClosedError,
    BoardNotFoundError,
    BoundSlot,
    Message,
    Sample,
    Slot,
    Whiteboard,
    WhiteboardError,
)
from llfsm.whiteboard.board import SlotInfo
from llfsm.whiteboard.messages.llfsm import JOURNALS, VIEWER, MachineStatus, Viewer

from .classes import class_of
from .history import History
from .source import Change, Look, Source

__all__ = ["LiveSource"]

_OPEN_NS = 300_000_000  # between two attempts to open a board that is not there
_LIST_NS = 400_000_000  # between two looks for new slots
_VIEW_NS = 500_000_000  # between two signs that somebody looks


class LiveSource(Source):
    """Pull from the board of a name, which may come, go and come again."""

    def __init__(self, name: str) -> None:
        self.title = name
        self._board: Whiteboard | None = None
        self._epoch = 0
        self._trouble = ""
        self._open_ns = self._list_ns = self._view_ns = 0  # when that is due
        self._history = History()
        self._forget()

    def _forget(self) -> None:
        self._slots: dict[str, SlotInfo] = {}
        self._bound: dict[str, BoundSlot[Message]] = {}
        self._samples: dict[str, Sample[Message]] = {}  # of the latest look
        self._unbound: dict[str, str] = {}  # problems of slots that cannot be read at all

    def look(self) -> Look:
        """Return how everything is; never raise because of what a board holds."""
        now_ns = time.monotonic_ns()
        samples: dict[str, Sample[Message]] = {}
        problems: dict[str, str] = {}
        try:
            board = self._open(now_ns)
            if board is not None:
                self._list(board, now_ns)
                self._tell(board, now_ns)
                problems |= self._unbound
                for name, bound in self._bound.items():
                    try:
                        sample = self._samples.get(name)
                        if sample is None or sample.count != bound.count:
                            sample = bound.sample()
                    except BoardClosedError:
                        raise
                    except WhiteboardError as error:
                        problems[name] = str(error)
                    else:
                        if sample is not None:
                            samples[name] = sample
        except Exception as error:  # also what a damaged file makes of the libraries that read it
            self._trouble = f"the whiteboard cannot be read: {error}; trying again"
            self.close()
        if self._board is not None:
            self._trouble = ""
            self._samples = samples
            self._history.note(samples, now_ns, self.is_live)
        return Look(now_ns, self._epoch, self._slots, samples, problems, self._trouble)

    def is_live(self, sample: Sample[MachineStatus]) -> bool:
        """Tell whether a machine is loaded by a process that lives."""
        return is_live(sample)

    def history(self) -> Mapping[str, Sequence[Change]]:
        """Return the states that each machine was seen in."""
        return self._history.changes

    def board(self) -> Whiteboard | None:
        """Return the board, if it is there."""
        return self._board

    def close(self) -> None:
        """Let go of the board."""
        if self._board is not None:
            self._board.close()
            self._board = None
            self._forget()

    def _open(self, now_ns: int) -> Whiteboard | None:
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
                    f"something runs on it, as: llfsm demo wall --board {self.title}"
                )
                return None
            self._epoch += 1
            self._history = History()
            self._list_ns = self._view_ns = 0
        return self._board

    def _list(self, board: Whiteboard, now_ns: int) -> None:
        if now_ns < self._list_ns:
            return
        self._list_ns = now_ns + _LIST_NS
        new = {
            info.name: info
            for info in board.slots()
            if info.name not in self._slots and not info.name.startswith(JOURNALS)
        }
        if new:
            self._slots = self._slots | new
        for name, info in new.items():
            try:
                self._bound[name] = board[Slot(name, class_of(info), info.capacity)]
            except BoardClosedError:
                raise
            except WhiteboardError as error:
                self._unbound[name] = str(error)

    def _tell(self, board: Whiteboard, now_ns: int) -> None:
        if now_ns >= self._view_ns:
            self._view_ns = now_ns + _VIEW_NS
            board.add_message(VIEWER, Viewer(os.getpid()))
