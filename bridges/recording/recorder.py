"""From a whiteboard into a file.

The board is looked at a thousand times a second. Of a slot that changes more often only the newest
message is recorded; its count tells how many were missed.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from fnmatch import fnmatchcase
from math import inf
from typing import Any, Final

from llfsm.runtime.engine.failure import logger
from llfsm.whiteboard import BoardClosedError, BoundSlot, Slot, Whiteboard, WhiteboardError
from llfsm.whiteboard.messages.llfsm import JOURNALS, RECORDER, VARIABLES, VIEWER, Viewer

from ..view.classes import class_of
from .receiver import JournalReceiver
from .writer import RecordingWriter

__all__ = ["BoardRecorder", "record"]

_LOOK_S: Final = 0.001  # a slot keeps its latest message alone: who looks seldom misses some
_PATIENCE_S: Final = 5.0  # for machines to end after their board was removed
_LIST_NS: Final = 100_000_000  # between two looks for new slots
_VIEW_NS: Final = 500_000_000  # between two signs that somebody wants the machines' variables


class BoardRecorder:
    """Write what is new in the slots of a board whose names match one of `patterns`, if any."""

    def __init__(self, board: Whiteboard, writer: RecordingWriter, patterns: Sequence[str] = ()):
        self._board = board
        self._writer = writer
        self._patterns = patterns
        self._slots: dict[str, tuple[Slot[Any], BoundSlot[Any]]] = {}
        self._counts: dict[str, int] = {}
        self._new: set[str] = set()  # slots that were made since the recording began
        self._unreadable: set[str] = set()
        self._list_ns = self._view_ns = 0  # when that is due
        self._find_slots()
        self._new.clear()

    @property
    def alive(self) -> bool:
        """Whether anybody may still write to the board."""
        return self._board.alive

    def look(self, *, last: bool = False) -> None:
        """Write each message that has come since the last look and is still there."""
        now_ns = time.monotonic_ns()
        if last or now_ns >= self._list_ns:
            self._find_slots()
            self._list_ns = now_ns + _LIST_NS
        if now_ns >= self._view_ns and self.wants(VARIABLES):
            self._view_ns = now_ns + _VIEW_NS
            self._tell()
        for name, (slot, bound) in self._slots.items():
            if bound.count != self._counts[name]:
                self._take(name, slot, bound)

    def _take(self, name: str, slot: Slot[Any], bound: BoundSlot[Any]) -> None:
        self._counts[name] = bound.count
        try:
            sample = bound.sample()
        except BoardClosedError:
            raise
        except WhiteboardError as error:
            self._warn(name, error)
        else:
            if sample is not None:
                self._counts[name] = sample.count
                self._writer.add(slot, sample, new=name in self._new)

    def _find_slots(self) -> None:
        for info in self._board.slots():
            if info.name in self._slots or info.name in self._unreadable:
                continue
            if info.name.startswith(JOURNALS) or info.name == RECORDER.name:
                continue
            if not self.wants(info.name):
                continue
            try:
                slot = Slot(info.name, class_of(info), info.capacity)
                self._slots[info.name] = slot, self._board[slot]
                self._counts[info.name] = 0
                self._new.add(info.name)
            except BoardClosedError:
                raise
            except WhiteboardError as error:
                self._warn(info.name, error)

    def _tell(self) -> None:
        try:
            self._board.add_message(VIEWER, Viewer(os.getpid()))
        except BoardClosedError:
            raise
        except WhiteboardError as error:  # a board that is full can be recorded all the same
            self._warn(VARIABLES + "*", error)

    def wants(self, name: str) -> bool:
        """Tell whether a name matches one of the patterns, if there are any."""
        return not self._patterns or any(fnmatchcase(name, each) for each in self._patterns)

    def _warn(self, name: str, error: Exception) -> None:
        if name not in self._unreadable:
            self._unreadable.add(name)
            logger().warning("slot %s is not recorded, or not all of it: %s", name, error)


def record(
    board: BoardRecorder,
    journals: JournalReceiver | None,
    writer: RecordingWriter,
    is_over: Callable[[], bool],
) -> None:
    """Record until `is_over`, or the board is removed and the journals on it have ended."""
    last, until = False, inf
    while not last:
        if until == inf and not board.alive:
            until = time.monotonic() + _PATIENCE_S
        last = is_over() or (
            until < inf and (journals is None or journals.idle or time.monotonic() > until)
        )
        if journals is not None:
            journals.look()
        board.look(last=last)  # once more at the end, for what came meanwhile
        writer.flush_if_due()
        if not last:
            time.sleep(_LOOK_S)
