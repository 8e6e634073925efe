"""A live board as a page's source."""

from __future__ import annotations

import os
import time
from collections.abc import Mapping, Sequence
from typing import Any

from llfsm.runtime.presence.remote import is_live
from llfsm.runtime.presence.shown import Shown
from llfsm.whiteboard import Board, Message, Sample
from llfsm.whiteboard.board import SlotInfo
from llfsm.whiteboard.board_files import DIRECTORY
from llfsm.whiteboard.messages.llfsm import (
    MACHINES,
    REQUESTS,
    MachineRequest,
    MachineStatus,
    Viewer,
)
from llfsm.whiteboard.poller import BoardPoller, is_data

from .notes import Note, Notes
from .page_source import Change, PageSource, Snapshot
from .reopened_board import ReopenedBoard
from .state_history import StateHistory

__all__ = ["LiveSource"]

_DISCOVERY_S = 0.4  # between two searches for new slots
_VIEW_NS = 500_000_000  # between two messages that the variables are viewed


class LiveSource(PageSource):
    """Poll the board of a name, which may be removed and made again, or `given`.

    That one is of this process, and its owner closes it. Of a `host` of the fleet, if any, only
    what it has is shown.
    """

    def __init__(
        self,
        name: str,
        directory: str | os.PathLike[str] = DIRECTORY,
        *,
        given: Board | None = None,
        host: str = "",
    ) -> None:
        self.title = f"{name}, {host}" if host else name
        self._host = host
        self._opened = ReopenedBoard(name, directory, given)
        self._shown: Shown | None = None
        self._poller: BoardPoller | None = None
        self._slots: dict[str, SlotInfo] = {}
        self._epoch = 0
        self._trouble = ""
        self._view_ns = 0  # when that is due
        self._history = StateHistory()
        self._notes = Notes()

    def snapshot(self) -> Snapshot:
        """Return the state of everything; never raise because of what a board holds."""
        now_ns = time.monotonic_ns()
        samples: dict[str, Sample[Message]] = {}
        problems: dict[str, str] = {}
        try:
            self._open(now_ns)
            if self._shown is not None and self._poller is not None:
                self._shown.look()
                self._poller.poll()
                slots = self._poller.slots
                samples = {n: each.sample for n, each in slots.items() if each.sample is not None}
                problems = {n: each.problem for n, each in slots.items() if each.problem}
                if slots.keys() != self._slots.keys():
                    self._slots = {name: each.info for name, each in slots.items()}
                if now_ns >= self._view_ns:
                    self._view_ns = now_ns + _VIEW_NS
                    self._shown.ask(Viewer(os.getpid(), why=True), slots)
                fleet = self._shown.fleet
                self._trouble = "" if fleet is None else fleet.problem()
        except Exception as error:  # also what a damaged file makes of the libraries that read it
            self._trouble = f"the whiteboard cannot be read: {error}; trying again"
            self.close()
        if self._opened.board is not None:
            self._history.add(samples, now_ns, self.is_live)
            self._note(samples)
        return Snapshot(now_ns, self._epoch, self._slots, samples, problems, self._trouble)

    def is_live(self, sample: Sample[MachineStatus]) -> bool:
        """Return whether a machine is loaded by a process that lives."""
        return is_live(sample)

    def history(self) -> Mapping[str, Sequence[Change]]:
        """Return the states in which each machine was seen."""
        return self._history.changes

    def notes(self) -> Sequence[Note]:
        """Return what else was seen to happen to machines."""
        return self._notes.all

    def board(self) -> Board | None:
        """Return the board, or None while it does not exist."""
        return self._opened.board

    def close(self) -> None:
        """Close the board."""
        self._opened.close()
        self._forget()

    def _forget(self) -> None:
        self._shown = self._poller = None
        self._slots = {}

    def _open(self, now_ns: int) -> None:
        before, board = self._opened.board, self._opened.look(now_ns)
        if board is None:  # also between the attempts to open one that could not be read
            self._trouble = self._opened.trouble or self._trouble
        if board is before:
            return
        self._forget()
        if board is None:
            return
        self._shown = shown = Shown(board, self._host)
        self._poller = BoardPoller(
            board,
            wants=lambda name: is_data(name) and shown.has(name),
            discovery_s=_DISCOVERY_S,
        )
        self._epoch += 1
        self._history, self._notes = StateHistory(), Notes()
        self._view_ns = 0

    def _note(self, samples: Mapping[str, Sample[Message]]) -> None:
        for slot, each in samples.items():
            sample: Sample[Any] = each
            if isinstance(sample.message, MachineStatus):
                self._notes.take_status(slot.removeprefix(MACHINES), sample)
            elif isinstance(sample.message, MachineRequest):
                self._notes.take_request(slot.removeprefix(REQUESTS), sample)
