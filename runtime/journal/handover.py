"""An arrangement's journal on its way to the recorder of its whiteboard.

Who records says on the board who it is, and what it has taken. A part of a journal is posted when
the one before it was taken: so nobody waits, and nothing is lost because a process had its turn
too late. What a recorder that stands still does not take is kept, up to a limit.
"""

from __future__ import annotations

import os
import time
from contextlib import suppress
from typing import TYPE_CHECKING, Final

from llfsm.whiteboard.errors import BoardClosedError, BoardFullError, WhiteboardError
from llfsm.whiteboard.liveness import born, lives
from llfsm.whiteboard.messages.llfsm import RECORDER, JournalPart, Recorder, journal_slot

from ..engine.failure import logger
from .entries import Journal

if TYPE_CHECKING:
    from llfsm.whiteboard import Board, BoundSlot

    from ..engine.arrangement import Arrangement

__all__ = ["Handover", "Reporter", "find_recorder"]

_SLOTS: Final = 64  # journals that a board may carry at a time
_ROOM: Final = journal_slot(0).capacity - 128  # bytes of a journal in one part
_MOST: Final = 64 << 20  # bytes that are kept before the recorder counts as stuck
_BEAT_NS: Final = 250_000_000  # between two looks whether the recorder lives
_PATIENCE_S: Final = 5.0  # for the next part to be taken at the end


def find_recorder(board: Board) -> Recorder | None:
    """Return who records the machines on a board; None if nobody does, or whoever did has died."""
    recorder = board[RECORDER].get()
    if recorder is None or not lives(recorder.pid, recorder.born):
        return None
    return recorder


class Handover:
    """Hand the entries of a `journal` over to `recorder`; `works` until there is none any more.

    `whole` is a journal that begins before its machines have done anything. Raise
    :class:`.BoardFullError` if the board has no room for it.
    """

    def __init__(self, board: Board, recorder: Recorder, *, whole: bool):
        self.journal = Journal(self._take)
        self.works = True
        self._recorder: BoundSlot[Recorder] = board[RECORDER]
        self._to = recorder.pid, recorder.born
        pid = os.getpid()
        self._open = JournalPart(pid, born(pid), time.monotonic_ns(), whole, 0)
        self._left = bytearray()
        self._part = 0
        self._told = False  # that something was lost
        self._beat_ns = 0
        self._place, self._slot, self._count = self._claim(board, recorder)

    def _claim(self, board: Board, recorder: Recorder) -> tuple[int, BoundSlot[JournalPart], int]:
        """Post that a journal begins, on a slot that is nobody's and from which all was taken."""
        for place in range(_SLOTS):
            slot = board[journal_slot(place)]
            before = slot.sample()
            if before is not None:
                last = before.message
                if not last.over and lives(last.pid, last.born):
                    continue
                if _taken(recorder, place) < before.count:
                    continue
            count = slot.add_after(self._open, 0 if before is None else before.count)
            if count:  # else another one has found it, too
                return place, slot, count
        raise BoardFullError(f"{board.name}: {_SLOTS} arrangements are recorded on it already")

    def go_on(self) -> None:
        """Post what comes next if it can be; never wait."""
        if not self.works:
            return
        try:
            recorder = self._recorder.get()
            if recorder is None or (recorder.pid, recorder.born) != self._to:
                self._stop()
            elif self._is_dead(recorder):
                logger().warning("the recorder is gone: the machines go on unrecorded")
                self._stop()
            elif (self._left or self.journal.ended) and self._is_taken(recorder):
                self._post()
        except BoardClosedError:
            self.works = False
        except WhiteboardError as error:
            self.works = False
            logger().warning("the machines go on unrecorded: %s", error)

    def _take(self, data: bytes) -> None:
        if not self.works:
            return
        if len(self._left) + len(data) > _MOST:
            self._lose()
        self._left += len(data).to_bytes(4, "little") + data
        self.go_on()
        if self.journal.ended:
            self._finish()

    def _finish(self) -> None:
        """Wait until the rest is taken, as long as any of it is."""
        until, part = 0.0, -1
        while self.works:
            if part != self._part:
                until, part = time.monotonic() + _PATIENCE_S, self._part
            if time.monotonic() > until:
                if self._left:
                    self._lose()
                self._stop()
            time.sleep(0.001)  # till the recorder has taken a part, or died: go_on looks for both
            self.go_on()

    def _lose(self) -> None:
        """Forget what was not taken; that a number is left out tells of it."""
        self._left.clear()
        self._part += 1
        if not self._told:
            self._told = True
            logger().warning("the recorder does not keep up: events are lost on the way to it")

    def _is_dead(self, recorder: Recorder) -> bool:
        now_ns = time.monotonic_ns()
        if now_ns < self._beat_ns:
            return False
        self._beat_ns = now_ns + _BEAT_NS
        return not lives(recorder.pid, recorder.born)

    def _is_taken(self, recorder: Recorder) -> bool:
        return _taken(recorder, self._place) >= self._count

    def _post(self) -> None:
        data = bytes(self._left[:_ROOM])
        del self._left[:_ROOM]
        self._add(data, over=self.journal.ended and not self._left)

    def _stop(self) -> None:
        """Leave the slot to others."""
        self._left.clear()
        with suppress(WhiteboardError):
            self._add(b"", over=True)
        self.works = False

    def _add(self, data: bytes, *, over: bool) -> None:
        self._part += 1
        first = self._open
        part = JournalPart(
            first.pid, first.born, first.session, first.whole, self._part, over, data
        )
        self._count = self._slot.add_after(part, self._count)
        self.works = not over and self._count > 0


class Reporter:
    """Give the events of an arrangement to whoever records its board, for as long as somebody does.

    To one that has come after the machines began it gives those from then on.
    """

    def __init__(self, arrangement: Arrangement, board: Board):
        self._arrangement = arrangement
        self._board = board
        self._recorder = board[RECORDER]
        self._seen = 0  # the latest of its messages that was looked at

    def look(self) -> None:
        """Begin if a recorder has come, go on while there is one, and end when it has gone."""
        handover = self._arrangement.handover
        try:
            if handover is None and self._recorder.count != self._seen:
                self._seen = self._recorder.count
                recorder = find_recorder(self._board)
                if recorder is not None:
                    self._begin(Handover(self._board, recorder, whole=False))
        except BoardClosedError:  # which stops the arrangement, when it looks
            pass
        except WhiteboardError as error:
            logger().warning("the machines go on unrecorded: %s", error)
        if handover is not None:
            handover.journal.flush()
            handover.go_on()
            if not handover.works:
                self._arrangement.handover = None
                self._arrangement.detach(handover.journal)

    def _begin(self, handover: Handover) -> None:
        arrangement = self._arrangement
        arrangement.handover = handover
        for standing in filter(None, arrangement.standings()):
            path = type(arrangement.machine(standing.machine)).table.path
            handover.journal.add(("Loaded", standing.machine, path))
        arrangement.attach(handover.journal)


def _taken(recorder: Recorder, place: int) -> int:
    return recorder.taken[place] if place < len(recorder.taken) else 0
