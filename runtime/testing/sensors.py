"""Scripted sensors: messages that come at given times."""

from __future__ import annotations

from collections.abc import Iterable
from operator import itemgetter
from typing import Any

from llfsm.whiteboard import Board, Slot
from llfsm.whiteboard.errors import wrong_type

from ..engine.events import Event, RoundBegin
from .errors import ScriptError

__all__ = ["SensorScript"]


class SensorScript:
    """Observe an arrangement and post each (time in ms, slot, message) when its time has come.

    Times count from the first round that it sees. A message is there for the first ringlet of
    the first round at its time or later, so it works with `run`, `round` and `run_until` alike.
    Raise `ScriptError` for a time before 0, and `SlotTypeError` for a message of another type
    than its slot's.
    """

    def __init__(self, board: Board, script: Iterable[tuple[float, Slot[Any], Any]]):
        self._board = board
        self._left = sorted(script, key=itemgetter(0))
        self._begin_ns: int | None = None
        for time_ms, slot, message in self._left:
            if not time_ms >= 0:
                raise ScriptError(f"{slot.name} at {time_ms} ms: a script begins at 0 ms")
            if type(message) is not slot.type:
                raise wrong_type(slot.name, slot.type, message)

    @property
    def finished(self) -> bool:
        """Whether every message was posted."""
        return not self._left

    def __call__(self, event: Event) -> None:
        """Take an event."""
        if not isinstance(event, RoundBegin):
            return
        if self._begin_ns is None:
            self._begin_ns = event.time_ns
        passed_ns = event.time_ns - self._begin_ns
        while self._left and self._left[0][0] * 1e6 <= passed_ns:
            _, slot, message = self._left.pop(0)
            self._board.add_message(slot, message)
