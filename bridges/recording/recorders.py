"""Recorders: of a board's slots, of its machines' journals, and of machines that play a script.

A slot holds its latest message only, so slots are polled a thousand times a second; the counts show
how many messages were missed all the same. A journal misses none: the process of an arrangement
posts it in parts to a slot of its own, and posts the next part when the recorder has announced, by
the slot `llfsm/recorder`, that it has taken the one before (:mod:`llfsm.runtime.journal.handover`).
Only one process records a board's machines. It claims that slot, and loses it if it is held up for
so long that another one takes its place.

A script is recorded at once, at the times of its manual clock. Its file has what a recording of a
robot has, so it is shown and rerun like one.
"""

from __future__ import annotations

import importlib.metadata
import os
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import msgspec

from llfsm.bridges.recording.writer import JournalWriter, RecordingWriter
from llfsm.runtime.journal.entries import Entry, Journal, entries_of
from llfsm.runtime.journal.handover import BEAT_NS, is_there
from llfsm.runtime.log import logger
from llfsm.runtime.presence.hosts import Shown
from llfsm.runtime.presence.remote import SILENT_S
from llfsm.runtime.testing.play import ScriptRun
from llfsm.whiteboard import BoardClosedError, BoundSlot, Sample, Whiteboard, WhiteboardError
from llfsm.whiteboard.liveness import host_name, identity, process_text, this_process
from llfsm.whiteboard.messages.llfsm import (
    JOURNALS,
    RECORDER,
    VARIABLES,
    VIEWER,
    JournalPart,
    Recorder,
    Viewer,
    journal_slot,
)
from llfsm.whiteboard.poller import BoardPoller, is_data

if TYPE_CHECKING:
    from llfsm.runtime.engine.kernel import OnError
    from llfsm.runtime.engine.schedule import Timetable
    from llfsm.runtime.testing.play import Loading
    from llfsm.runtime.testing.scripted import Step


_LARGEST: Final = 1 << 27  # bytes of a batch of entries: a longer one is nonsense
_POLL_S: Final = 0.001  # a slot holds its latest message only: slower polling misses more
_DISCOVERY_S: Final = 0.1  # between two searches for new slots
_VIEW_NS: Final = 500_000_000  # between two messages that ask for the machines' variables
_BEAT_MS: Final = SILENT_S * 1e3 / 2
"""Statuses are this far apart, so that nothing seems silent in the page."""
_MOST_BEATS: Final = 1_000


class JournalRecorder:
    """Announce on a board that its machines are recorded, and write their journals.

    `other` is the process that records them already, in words, else "". If there is one, this
    recorder does nothing. Nor does it once another one has taken its place.
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
        """The number of journals that were begun."""
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
        """Post what was taken, if the latest message has that count: else another one records."""
        taken = msgspec.structs.replace(self._me, taken=tuple(self._taken))
        self._count = self._recorder.add_after(taken, after)
        self._beat_ns = time.monotonic_ns() + BEAT_NS

    def _add_slot(self) -> None:
        self._slots.append(self._board[journal_slot(len(self._slots))])
        self._taken.append(0)

    def _add_spare_slot(self) -> None:
        """Read one slot more than are in use, so that the next journal is taken at once.

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
        """Write the parts of journals that have arrived, and announce that they were taken."""
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
        """True once all journals have ended, or their processes have."""
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
        """Check that a part belongs to it."""
        first = self._first
        return part.session == first.session and identity(part) == identity(first)

    @property
    def over(self) -> bool:
        """True once no more parts can arrive."""
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


@dataclass(eq=False)
class BoardRecorder:
    """Write the new messages in the slots of a board whose names match one of `patterns`, if any.

    Of these only the slots that are `shown`; by default all.
    """

    board: Whiteboard
    writer: RecordingWriter
    patterns: Sequence[str] = ()
    shown: Shown | None = None

    def __post_init__(self) -> None:
        self._shown = self.shown or Shown(self.board)
        self._view_ns = 0  # when that is due
        self._warned: set[str] = set()
        self._poller = BoardPoller(self.board, wants=self._is_recorded, discovery_s=_DISCOVERY_S)
        self._poller.discover()
        self._old = frozenset(self._poller.slots)  # made before the recording began

    def poll(self, *, last: bool = False) -> None:
        """Write each message that is new since the last poll and was not replaced yet."""
        now_ns = time.monotonic_ns()
        self._shown.look()
        if last:
            self._poller.discover()
        if now_ns >= self._view_ns and self.wants(VARIABLES):
            self._view_ns = now_ns + _VIEW_NS
            self._ask_for_variables()
        for polled in self._poller.poll():
            if polled.slot is None or polled.sample is None:
                if polled.problem:  # else the name was given up
                    self._warn(polled.name, polled.problem)
            else:
                new, sample = polled.name not in self._old, polled.sample
                latest_ns = time.monotonic_ns()
                if sample.stamp_ns > latest_ns:  # a damaged board's
                    sample = sample._replace(stamp_ns=latest_ns)
                self.writer.add(polled.slot, sample, new=new)

    def wants(self, name: str) -> bool:
        """Check that a name matches one of the patterns, or that there are none."""
        return not self.patterns or any(fnmatchcase(name, each) for each in self.patterns)

    def _is_recorded(self, name: str) -> bool:
        is_wanted = is_data(name) and name != RECORDER.name and self.wants(name)
        return is_wanted and self._shown.has(name)

    def _ask_for_variables(self) -> None:
        try:
            self._shown.ask(Viewer(os.getpid()), self._poller.slots)
        except BoardClosedError:
            raise
        except WhiteboardError as error:  # a board that is full can be recorded all the same
            self._warn(VARIABLES + "*", str(error))

    def _warn(self, name: str, problem: str) -> None:
        if name not in self._warned:
            self._warned.add(name)
            logger().warning("slot %s is not recorded, or not all of it: %s", name, problem)


def record(
    board: BoardRecorder,
    journals: JournalRecorder | None,
    writer: RecordingWriter,
    is_over: Callable[[], bool],
    *,
    patience_s: float = 5.0,
) -> None:
    """Record until `is_over`, or the board is removed and the journals on it have ended.

    Those that have not ended `patience_s` seconds after the removal are cut short.
    """
    last, until = False, inf
    while not last:
        if until == inf and not board.board.alive:
            until = time.monotonic() + patience_s
        last = is_over() or (
            until < inf and (journals is None or journals.idle or time.monotonic() > until)
        )
        if journals is not None:
            journals.poll()
        board.poll(last=last)  # once more at the end, for what came meanwhile
        writer.flush_if_due()
        if not last:
            time.sleep(_POLL_S)  # the pace of recording: see the head of this file


def record_script(
    file: Path,
    members: Iterable[Loading],
    script: Iterable[Step],
    *,
    plan: Any = None,
    folder: Path | None = None,
    unload_accepting: bool = True,
    on_error: OnError = "stop",
    timetable: Timetable | None = None,
) -> None:
    """Run `members` on a script, and write a recording of it.

    `llfsm rerun` makes the machines of `plan` again, in `folder`, by default the current one.
    Raise `RecordingFileError` for a file that is there already or cannot be written.
    """
    described = {
        "board": "counterexample",
        "host": host_name(),
        "version": importlib.metadata.version("llfsm"),
    }
    with RecordingWriter(file, described) as writer:
        start_ns, pid = writer.begin_ns, os.getpid()
        output = JournalWriter(writer, pid=pid, session=start_ns, whole=True)
        journal = Journal(lambda data: _write(output, data))
        if plan is not None:
            journal.add(("Plan", plan, str(folder or Path.cwd())))
        run = ScriptRun(
            members,
            unload_accepting=unload_accepting,
            on_error=on_error,
            timetable=timetable,
            journal=journal,
            start_ns=start_ns,
        )
        board = _ScriptRecorder(run, writer)
        for _ in run.play(board.paced(script)):
            journal.flush()
            board.record()
        journal.flush()


class _ScriptRecorder:
    """Let the machines publish their statuses, and write the new messages on their board."""

    def __init__(self, run: ScriptRun, writer: RecordingWriter):
        self._writer = writer
        self._clock = run.scripted.clock
        self._board = run.scripted.whiteboard
        self._viewer = Viewer(os.getpid())  # which asks for the machines' variables
        self._presence = run.scripted.attend(run.arrangement)
        self._poller = BoardPoller(run.scripted.whiteboard)
        self.record()

    def record(self) -> None:
        self._board.add_message(VIEWER, self._viewer)
        if self._presence is not None:
            self._presence.look(idle=True)
        for polled in self._poller.poll():
            if polled.slot is not None and polled.sample is not None:
                self._writer.add(polled.slot, polled.sample, new=True)

    def paced(self, script: Iterable[Step]) -> Iterator[Step]:
        """Yield the steps, and record between them, so that nothing seems silent on a page."""
        most_ms = max(_BEAT_MS, sum(step.wait_ms for step in script) / _MOST_BEATS)
        for step in script:
            left_ms = step.wait_ms
            while left_ms > most_ms:
                self._clock.advance(ms=most_ms)
                left_ms -= most_ms
                self.record()
            yield step._replace(wait_ms=left_ms)


def _write(output: JournalWriter, data: bytes) -> None:
    for entry in entries_of(data):
        output.add(entry)
