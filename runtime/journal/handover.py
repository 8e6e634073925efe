"""An arrangement's journal on its way to the recorder of its whiteboard.

A recorder publishes its process and what it has taken. A part of a journal is posted once the part
before it was taken: neither side ever waits, and nothing is lost because a process was scheduled
late. What a stalled recorder does not take is kept, up to a limit.
"""

from __future__ import annotations

import time
from contextlib import suppress
from typing import TYPE_CHECKING, Any, Final

import msgspec

from llfsm.runtime.journal.entries import Journal
from llfsm.runtime.log import logger
from llfsm.whiteboard.errors import BoardClosedError, BoardFullError, WhiteboardError
from llfsm.whiteboard.liveness import identity, is_alive, this_process
from llfsm.whiteboard.messages.llfsm import RECORDER, JournalPart, Recorder, journal_slot

if TYPE_CHECKING:
    from llfsm.runtime.engine.arrangement import Arrangement
    from llfsm.whiteboard import Board, BoundSlot, Sample


HANDOVER_LIMIT: Final = 64 << 20
"""Bytes that are kept for a recorder before it counts as stalled."""

SILENT_S: Final = 5.0
"""A recorder or an arrangement of another container that has posted nothing for so long is gone."""
BEAT_NS: Final = 250_000_000
"""Between two signs of life, and two looks for the other side's."""

_QUIET_NS: Final = 4 * BEAT_NS  # a journal without entries posts a part all the same
_SLOTS: Final = 64  # journals that a board may carry at a time
_ROOM: Final = journal_slot(0).capacity - 256  # bytes of a journal in one part


def find_recorder(board: Board) -> Recorder | None:
    """Return the process that records a board's machines; None if there is none or it died."""
    sample = board[RECORDER].sample()
    return sample.message if sample is not None and is_there(sample) else None


def is_there(sample: Sample[Any]) -> bool:
    """Check that the process lives that has posted a `Recorder` or a `JournalPart`."""
    silent_s = (time.monotonic_ns() - sample.stamp_ns) / 1e9
    return is_alive(sample.message, elsewhere=silent_s < SILENT_S)


class Handover:
    """Hand the entries of a `journal` over to `recorder`; `works` while that is possible.

    `whole` is a journal that begins before its machines have done anything. Up to `limit` bytes
    that the recorder has not taken are kept; at the end each next part has `patience_s` seconds to
    be taken. Raise :class:`.BoardFullError` if the board has no room for another journal.
    """

    def __init__(
        self,
        board: Board,
        recorder: Recorder,
        *,
        whole: bool,
        limit: int = HANDOVER_LIMIT,
        patience_s: float = 5.0,
    ):
        self.journal = Journal(self.write)
        self._limit = limit
        self._patience_s = patience_s
        self.works = True
        self._recorder: BoundSlot[Recorder] = board[RECORDER]
        self._to = identity(recorder)
        self._open = JournalPart(*this_process(), time.monotonic_ns(), whole, 0)
        self._left = bytearray()
        self._part = 0
        self._warned = False  # that something was lost
        self._beat_ns = 0
        self._posted_ns = time.monotonic_ns()
        self._is_due = False  # a sign of life
        self._place, self._slot, self._count = self._claim(board, recorder)

    def _claim(self, board: Board, recorder: Recorder) -> tuple[int, BoundSlot[JournalPart], int]:
        """Post that a journal begins, on a free slot from which everything was taken.

        One whose process is silent in another container may only be held up there: such a slot is
        taken if there is no other.
        """
        for may_live in (lambda sample: is_alive(sample.message, elsewhere=True), is_there):
            for place in range(_SLOTS):
                slot = board[journal_slot(place)]
                before = slot.sample()
                if before is not None:
                    if not before.message.over and may_live(before):
                        continue
                    if _taken(recorder, place) < before.count:
                        continue
                count = slot.add_after(self._open, 0 if before is None else before.count)
                if count:  # else another process has claimed it meanwhile
                    return place, slot, count
        raise BoardFullError(f"{board.name}: {_SLOTS} arrangements are recorded on it already")

    def go_on(self) -> None:
        """Post the next part if the last one was taken; never wait."""
        if not self.works:
            return
        try:
            recorder = self._recorder.get()
            if recorder is None or identity(recorder) != self._to:
                self._stop()
            elif self._is_dead():
                logger().warning("the recorder is gone: the machines go on unrecorded")
                self._stop()
            elif (self._left or self._is_due or self.journal.ended) and self._is_taken(recorder):
                self._post()
        except BoardClosedError:
            self.works = False
        except WhiteboardError as error:
            self.works = False
            logger().warning("the machines go on unrecorded: %s", error)

    def write(self, data: bytes) -> None:
        """Take entries from the journal."""
        if not self.works:
            return
        if len(self._left) + len(data) > self._limit:
            self._lose()
        self._left += len(data).to_bytes(4, "little") + data
        self.go_on()
        if self.journal.ended:
            self._finish()

    def _finish(self) -> None:
        """Wait until the rest is taken, as long as part after part is."""
        until, part = 0.0, -1
        while self.works:
            if part != self._part:
                until, part = time.monotonic() + self._patience_s, self._part
            if time.monotonic() > until:
                if self._left:
                    self._lose()
                self._stop()
            time.sleep(0.001)  # until the recorder takes a part or dies: go_on checks both
            self.go_on()

    def _lose(self) -> None:
        """Drop what was not taken; the missing number shows it to the recorder."""
        self._left.clear()
        self._part += 1
        if not self._warned:
            self._warned = True
            logger().warning("the recorder does not keep up: events are lost on the way to it")

    def _is_dead(self) -> bool:
        now_ns = time.monotonic_ns()
        if now_ns < self._beat_ns:
            return False
        self._beat_ns = now_ns + BEAT_NS
        self._is_due = now_ns - self._posted_ns >= _QUIET_NS
        sample = self._recorder.sample()
        return sample is None or not is_there(sample)

    def _is_taken(self, recorder: Recorder) -> bool:
        return _taken(recorder, self._place) >= self._count

    def _post(self) -> None:
        data = bytes(self._left[:_ROOM])
        del self._left[:_ROOM]
        over = self.journal.ended and not self._left
        self._add(data, over=over)
        if not (self.works or over):
            logger().warning("another journal has this one's slot: the machines go on unrecorded")

    def _stop(self) -> None:
        """Leave the slot to others."""
        self._left.clear()
        with suppress(WhiteboardError):
            self._add(b"", over=True)
        self.works = False

    def _add(self, data: bytes, *, over: bool) -> None:
        self._part += 1
        part = msgspec.structs.replace(self._open, number=self._part, over=over, data=data)
        self._posted_ns, self._is_due = time.monotonic_ns(), False
        self._count = self._slot.add_after(part, self._count)
        self.works = not over and self._count > 0


class Reporter:
    """Give the events of an arrangement to the recorder of its board, as long as there is one.

    `handover` is a journal that was begun before; a recorder that comes later gets the events from
    then on.
    """

    def __init__(self, arrangement: Arrangement, board: Board, handover: Handover | None = None):
        self._arrangement = arrangement
        self._board = board
        self._handover = handover
        self._recorder = board[RECORDER]
        self._seen = 0  # the latest of its messages that was looked at

    def look(self) -> None:
        """Begin when a recorder has come, go on while it is there, and end when it has gone."""
        handover = self._handover
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
                self._handover = None
                handover.journal.close()
                self._arrangement.detach(handover.journal)

    def _begin(self, handover: Handover) -> None:
        arrangement, self._handover = self._arrangement, handover
        for standing in filter(None, arrangement.roster.standings()):
            path = type(arrangement.machine(standing.machine)).table.path
            handover.journal.add(("Loaded", standing.machine, path))
        arrangement.attach(handover.journal)


def _taken(recorder: Recorder, place: int) -> int:
    return recorder.taken[place] if place < len(recorder.taken) else 0
