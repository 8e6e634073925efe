"""Arrangements that run by the definitions, although the twins in C are there."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from llfsm.runtime import Arrangement
from llfsm.runtime.engine import ringlet, rotation, timing, twin
from llfsm.runtime.engine.arrangement import Loadable
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

    unobserved = staticmethod(ringlet.ringlet)
    give_turns = rotation.Rotation.give_turns
    give_round = rotation.Rotation.give_round
    give_rounds = rotation.Rotation.give_rounds

    def __init__(self, machines: Iterable[Loadable] = (), **how: Any):
        super().__init__(machines, **how)
        if self.stopwatch is not None:
            self.stopwatch.__class__ = DefinedStopwatch
