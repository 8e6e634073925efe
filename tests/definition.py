"""Arrangements that run by the definitions, although the twins in C are there."""

from __future__ import annotations

from llfsm.runtime import Arrangement
from llfsm.runtime.engine import ringlet, rotation, timing, twin
from llfsm.runtime.engine.statistics import Stopwatch

__all__ = ["BUILT", "Defined"]

BUILT = twin.ringlet is not ringlet.ringlet
"""Whether there are twins."""


class DefinedStopwatch(Stopwatch):
    """A stopwatch that does in Python what each turn needs."""

    begin = timing.Timing.begin
    begin_due = timing.Timing.begin_due
    take = timing.Timing.take


class Defined(Arrangement):
    """An arrangement whose ringlets, rotation and timing are those in Python."""

    _give_turns = rotation.Rotation._give_turns
    _give_round = rotation.Rotation._give_round
    _rest = rotation.Rotation._rest

    def _bind_all(self) -> None:
        super()._bind_all()
        if self._turn is twin.ringlet:
            self._turn = ringlet.ringlet
        if self._stopwatch is not None:
            self._stopwatch.__class__ = DefinedStopwatch
