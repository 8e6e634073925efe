"""From a whiteboard into a file.

The board is polled a thousand times a second. If a slot changes more often, only the newest message
is recorded; the counts show how many were missed.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from fnmatch import fnmatchcase
from math import inf
from typing import Final

from llfsm.runtime.engine.failure import logger
from llfsm.runtime.presence.shown import Shown
from llfsm.whiteboard import BoardClosedError, Whiteboard, WhiteboardError
from llfsm.whiteboard.messages.llfsm import RECORDER, VARIABLES, Viewer
from llfsm.whiteboard.poller import BoardPoller, is_data

from .journal_recorder import JournalRecorder
from .writer import RecordingWriter

__all__ = ["BoardRecorder", "record"]

_POLL_S: Final = 0.001  # a slot holds its latest message only: slower polling misses more
_DISCOVERY_S: Final = 0.1  # between two searches for new slots
_VIEW_NS: Final = 500_000_000  # between two messages that ask for the machines' variables


class BoardRecorder:
    """Write what is new in the slots of a board whose names match one of `patterns`, if any.

    Of these only what is `shown`; by default all.
    """

    def __init__(
        self,
        board: Whiteboard,
        writer: RecordingWriter,
        patterns: Sequence[str] = (),
        shown: Shown | None = None,
    ):
        self._board = board
        self._shown = shown or Shown(board)
        self._writer = writer
        self._patterns = patterns
        self._view_ns = 0  # when that is due
        self._warned: set[str] = set()
        self._poller = BoardPoller(board, wants=self._is_recorded, discovery_s=_DISCOVERY_S)
        self._poller.discover()
        self._old = frozenset(self._poller.slots)  # made before the recording began

    @property
    def alive(self) -> bool:
        """Whether any process may still write to the board."""
        return self._board.alive

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
                self._warn(polled.name, polled.problem)
            else:
                new = polled.name not in self._old
                self._writer.add(polled.slot, polled.sample, new=new)

    def wants(self, name: str) -> bool:
        """Return whether a name matches one of the patterns, or there are none."""
        return not self._patterns or any(fnmatchcase(name, each) for each in self._patterns)

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
        if until == inf and not board.alive:
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
