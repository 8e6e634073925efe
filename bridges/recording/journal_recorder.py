"""The journals of a board's arrangements, received from their processes over the board."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Final

import msgspec

from llfsm.runtime.engine.failure import logger
from llfsm.runtime.journal.entries import Entry, entries_of
from llfsm.runtime.journal.handover import BEAT_NS, is_there
from llfsm.whiteboard import BoardClosedError, BoundSlot, Sample, Whiteboard, WhiteboardError
from llfsm.whiteboard.liveness import identity, process_text, this_process
from llfsm.whiteboard.messages.llfsm import (
    JOURNALS,
    RECORDER,
    JournalPart,
    Recorder,
    journal_slot,
)

from .journal_writer import JournalWriter
from .writer import RecordingWriter

__all__ = ["JournalRecorder"]

_LARGEST: Final = 1 << 27  # bytes of a batch of entries: a longer one is nonsense


class JournalRecorder:
    """Announce on a board that its machines are recorded, and write their journals.

    `other` is the process that records them already, in words. If there is one, this recorder is
    idle. So it is once another one has replaced it, because it was held up in its container.
    """

    def __init__(self, board: Whiteboard, writer: RecordingWriter):
        self._board = board
        self._writer = writer
        self._recorder = board[RECORDER]
        self._slots: list[BoundSlot[JournalPart]] = []
        self._taken: list[int] = []  # the count up to which each was read
        self._journals: dict[int, _IncomingJournal] = {}
        self._full = False
        self.journals = 0
        """How many journals were begun."""
        self._me = Recorder(*this_process())
        self._count = 0  # of the latest message about this recorder; 0 if it is idle
        self._beat_ns = 0  # when the next is due
        names = {info.name for info in board.slots()}
        while f"{JOURNALS}{len(self._slots)}" in names or not self._slots:
            self._add_slot()
        self._taken = [slot.count for slot in self._slots]  # that was meant for an earlier recorder
        self.other = self._claim()

    def _claim(self) -> str:
        while not self._count:
            before = self._recorder.sample()
            if before is not None and is_there(before):
                return process_text(before.message, "process")
            self._announce(0 if before is None else before.count)
        return ""

    def _announce(self, after: int) -> None:
        """Post what was taken, in place of the message of that count."""
        taken = msgspec.structs.replace(self._me, taken=tuple(self._taken))
        self._count = self._recorder.add_after(taken, after)
        self._beat_ns = time.monotonic_ns() + BEAT_NS

    def _add_slot(self) -> None:
        self._slots.append(self._board[journal_slot(len(self._slots))])
        self._taken.append(0)

    def _add_spare_slot(self) -> None:
        """Read one slot more than are in use, so that the next journal is seen at once.

        Another one may have begun there already, if two began since the last poll.
        """
        try:
            self._add_slot()
        except BoardClosedError:
            raise
        except WhiteboardError as error:
            self._full = True
            logger().warning("no more machines can be recorded: %s", error)

    def poll(self) -> None:
        """Write what has arrived."""
        if not self._count:
            return
        new = False
        for number, slot in enumerate(self._slots):
            if slot.count != self._taken[number]:
                new = True
                self._take(number, slot)
        if new and self._taken[-1] and not self._full:
            self._add_spare_slot()
        if new or time.monotonic_ns() >= self._beat_ns:
            self._announce(self._count)
            if not self._count:
                logger().warning("another process records the machines now, this one only slots")

    @property
    def idle(self) -> bool:
        """Whether all journals have ended, or their processes have."""
        return all(journal.over for journal in self._journals.values())

    def close(self) -> None:
        """Announce that recording has ended, and complete the journals."""
        for journal in self._journals.values():
            journal.close()
        try:
            self._recorder.add_after(Recorder(), self._count)
        except BoardClosedError:
            pass
        except WhiteboardError as error:
            logger().warning("%s", error)

    def _take(self, number: int, slot: BoundSlot[JournalPart]) -> None:
        self._taken[number] = slot.count
        try:
            sample = slot.sample()
        except BoardClosedError:
            raise
        except WhiteboardError as error:
            logger().warning("a part of a journal is lost: %s", error)
            return
        if sample is None:
            return
        self._taken[number] = sample.count
        part, journal = sample.message, self._journals.get(number)
        if journal is None or not journal.is_of(part):
            if part.number or part.over:  # of a journal begun for an earlier recorder
                return
            if journal is not None:
                journal.close()
            self._journals[number] = journal = _IncomingJournal(part, self._writer)
            self.journals += 1
        journal.take(sample)


class _IncomingJournal:
    """A journal that arrives in parts."""

    def __init__(self, first: JournalPart, writer: RecordingWriter):
        self._first = first
        self._latest: Sample[JournalPart] | None = None
        self._next = first.number
        self._left = bytearray()
        self._ended = False
        self._journal = JournalWriter(
            writer, pid=first.pid, session=first.session, whole=first.whole
        )

    def is_of(self, part: JournalPart) -> bool:
        """Return whether a part belongs to it."""
        first = self._first
        return part.session == first.session and identity(part) == identity(first)

    @property
    def over(self) -> bool:
        """Whether no more parts can arrive."""
        return self._ended or self._latest is None or not is_there(self._latest)

    def take(self, sample: Sample[JournalPart]) -> None:
        """Write the entries of a part."""
        part, self._latest = sample.message, sample
        if self._ended:
            return
        if part.number != self._next:
            self._left.clear()
            self._journal.add_lost()
        self._next = part.number + 1
        self._left += part.data
        try:
            for entry in self._entries():
                if "reads" in entry:
                    self._describe()
                self._journal.add(entry)
        except (ValueError, LookupError, TypeError) as error:  # also msgspec's
            logger().warning("process %d writes an invalid journal: %s", self._first.pid, error)
            self._ended = True
        if part.over:
            self.close()

    def close(self) -> None:
        """End it; describe its arrangement in the file if that was not done."""
        self._ended = True
        self._describe()

    def _entries(self) -> Iterator[Entry]:
        while len(self._left) >= 4:
            end = 4 + int.from_bytes(self._left[:4], "little")
            if end > _LARGEST:
                raise ValueError(f"{end} bytes at once")
            if len(self._left) < end:
                return
            data = bytes(self._left[4:end])
            del self._left[:end]
            yield from entries_of(data)

    def _describe(self) -> None:
        """Describe its arrangement in the file, and log, once, if its beginning is missing."""
        if not self._journal.describe() and not self._first.whole:
            logger().warning(
                "%s (process %d) was running before the recording: its events are recorded from "
                "now on and cannot be rerun",
                ", ".join(self._journal.machines) or "an arrangement",
                self._first.pid,
            )
