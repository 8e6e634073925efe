"""A live board as a page's source, with the states in which each machine was seen.

The board of a name may be made later, removed, and made again. A machine publishes its status, not
each change, so a state that lasted less than a snapshot's period can be missed; the next change
then says that states were skipped. Between two snapshots that are far apart, states are unknown.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, cast

from llfsm.bridges.view.page_source import Change, Note, Notes, PageSource, Snapshot
from llfsm.runtime.presence.hosts import Shown
from llfsm.runtime.presence.remote import is_live
from llfsm.whiteboard import Board, BoardNotFoundError, Message, Sample, Whiteboard
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

_OPEN_NS = 300_000_000  # between two attempts to open a board that is not there


class ReopenedBoard:
    """Open the board of a name as often as it is made; or use `given`, which its owner closes."""

    def __init__(
        self,
        name: str,
        directory: str | os.PathLike[str] = DIRECTORY,
        given: Board | None = None,
    ) -> None:
        self.board: Board | None = None
        """The board, or None while it does not exist."""
        self.trouble = ""
        """Why there is none, and what to do."""
        self._name = name
        self._directory = directory
        self._given = given
        self._open_ns = 0  # when that is due

    def look(self, now_ns: int) -> Board | None:
        """Return the board; it is another one after it was removed and made again."""
        if self.board is not None and not self.board.alive:
            self.trouble = f"the whiteboard {self._name!r} was removed; waiting for a new one"
            self.close()
        if self.board is None and now_ns >= self._open_ns:
            self._open_ns = now_ns + _OPEN_NS
            try:
                self.board = self._given or Whiteboard(
                    self._name, directory=self._directory, create=False
                )
                self.trouble = ""
            except BoardNotFoundError:
                self.trouble = self.trouble or (
                    f"there is no whiteboard {self._name!r} yet; it appears here as soon as "
                    f"something runs on it, for example: llfsm demo wall --board {self._name}"
                )
        return self.board

    def close(self) -> None:
        """Close the board."""
        if self.board is not None and self.board is not self._given:
            self.board.close()
        self.board = None


_MOST_CHANGES = 4_000  # of a machine
_GAP_NS = 1_000_000_000  # between two snapshots: longer, and the states between are unknown


class Track:
    """The states of one machine, as far as they are published; stamps increase strictly."""

    def __init__(self) -> None:
        self.changes: list[Change] = []
        self._entered_ns = 0

    def update(self, sample: Sample[MachineStatus]) -> None:
        """Add the state of a published status, if it is new."""
        status = sample.message
        last = self.changes[-1] if self.changes else Change(0, "", False)
        # A status before the first turn in a state has no time of entry; the next one of it has.
        again = 0 < self._entered_ns != status.entered_ns > 0
        self._entered_ns = status.entered_ns
        now = status.state, status.suspended, status.failed
        if again or now != (last.state, last.suspended, last.failed):
            since_s = status.in_state_s
            if not again and status.state == last.state:  # it was suspended, resumed, or has failed
                since_s = status.error_s if status.failed else 0.0
            began_ns = sample.stamp_ns - round(since_s * 1e9)
            skipped = bool(status.source and last.state) and status.source != last.state
            way = status.source, status.transition, skipped
            self.add(Change(began_ns, status.state, status.suspended, *way, status.failed))

    def add(self, change: Change) -> None:
        """Add a change; its stamp is made later than the one before."""
        before_ns = self.changes[-1].stamp_ns if self.changes else -1
        self.changes.append(change._replace(stamp_ns=max(change.stamp_ns, before_ns + 1)))

    def lose(self, now_ns: int) -> None:
        """Note that the machine has ended, or that its state is unknown."""
        self._entered_ns = 0
        if self.changes and self.changes[-1].state:
            self.add(Change(now_ns, "", False))


class StateHistory:
    """Collect the states in successive snapshots; the oldest changes are dropped."""

    def __init__(self) -> None:
        self.changes: dict[str, list[Change]] = {}
        self._tracks: dict[str, Track] = {}
        self._latest_ns = 0

    def add(
        self,
        samples: Mapping[str, Sample[Message]],
        now_ns: int,
        is_live: Callable[[Sample[MachineStatus]], bool],
    ) -> None:
        """Add what has changed in the samples at `now_ns`."""
        if now_ns - self._latest_ns > _GAP_NS:
            for track in self._tracks.values():
                track.lose(self._latest_ns)
        self._latest_ns = now_ns
        for slot, each in samples.items():
            if not isinstance(each.message, MachineStatus):
                continue
            sample, name = cast("Sample[MachineStatus]", each), slot.removeprefix(MACHINES)
            if name not in self._tracks:
                self._tracks[name] = Track()
                self.changes[name] = self._tracks[name].changes
            track = self._tracks[name]
            if is_live(sample):
                track.update(sample)
            else:
                track.lose(now_ns)
            if len(track.changes) > _MOST_CHANGES:
                del track.changes[: _MOST_CHANGES // 2]


_DISCOVERY_S = 0.4  # between two searches for new slots
_VIEW_NS = 500_000_000  # between two messages that the variables are viewed


class LiveSource(PageSource):
    """Poll a `ReopenedBoard`; of a `host` of the fleet, if any, only what it has is shown."""

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
        """Check that a machine is loaded by a process that is alive now."""
        return is_live(sample)

    def history(self) -> Mapping[str, Sequence[Change]]:
        """Return the states in which each machine was seen."""
        return self._history.changes

    def notes(self) -> Sequence[Note]:
        """Return the notes on machines, by time."""
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
