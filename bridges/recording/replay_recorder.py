"""A recording of machines that play a script, made at once and at the times of their clock.

It has what a recording of a robot has, so it is shown and run again like one.
"""

from __future__ import annotations

import importlib.metadata
import os
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from llfsm.runtime.journal.entries import Journal, entries_of
from llfsm.runtime.presence.remote import SILENT_S
from llfsm.runtime.testing.playback import Playback
from llfsm.whiteboard.liveness import host_name
from llfsm.whiteboard.messages.llfsm import VIEWER, Viewer
from llfsm.whiteboard.poller import BoardPoller

from .journal_writer import JournalWriter
from .writer import RecordingWriter

if TYPE_CHECKING:
    from llfsm.runtime.testing.play import Loading
    from llfsm.runtime.testing.scripted import Step

__all__ = ["record_replay"]

_BEAT_MS: Final = SILENT_S * 1e3 / 2
"""Statuses are this far apart, so that nothing seems silent in the page."""
_MOST_BEATS: Final = 1_000


def record_replay(
    file: Path,
    members: Iterable[Loading],
    script: Sequence[Step],
    *,
    plan: Any = None,
    folder: Path | None = None,
    unload_accepting: bool = True,
) -> None:
    """Play `script` to `members` and write a recording of it.

    `plan` is what `llfsm rerun` makes the machines of, in `folder`, by default the current one.
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
        playback = Playback(
            members, unload_accepting=unload_accepting, journal=journal, start_ns=start_ns
        )
        board = _BoardRecorder(playback, writer)
        for _ in playback.play(board.paced(script)):
            journal.flush()
            board.record()
        journal.flush()


class _BoardRecorder:
    """Write what is new on the board, and let the machines publish their statuses."""

    def __init__(self, playback: Playback, writer: RecordingWriter):
        self._writer = writer
        self._clock = playback.scripted.clock
        self._board = playback.scripted.whiteboard
        self._viewer = Viewer(os.getpid())  # which asks for the machines' variables
        self._presence = playback.scripted.attend(playback.arrangement)
        self._poller = BoardPoller(playback.scripted.whiteboard)
        self.record()

    def record(self) -> None:
        self._board.add_message(VIEWER, self._viewer)
        if self._presence is not None:
            self._presence.look(idle=True)
        for polled in self._poller.poll():
            if polled.slot is not None and polled.sample is not None:
                self._writer.add(polled.slot, polled.sample, new=True)

    def paced(self, script: Sequence[Step]) -> Iterator[Step]:
        """Return the steps, and record what time passes before each of them."""
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
