"""Arrangements that run by the definitions, although the twins in C are there."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from llfsm.runtime import Arrangement
from llfsm.runtime.engine.kernel import Kernel, Loadable
from llfsm.runtime.engine.ringlet import DefinedRotation, defined_ringlet, ringlet
from llfsm.runtime.engine.statistics import DefinedTiming, Stopwatch

__all__ = ["BUILT", "Defined", "DefinedKernel"]

BUILT = ringlet is not defined_ringlet
"""Whether there are twins."""


class DefinedStopwatch(Stopwatch):
    """A stopwatch that does in Python what each turn needs."""

    begin = DefinedTiming.begin
    begin_due = DefinedTiming.begin_due
    take = DefinedTiming.take


class DefinedKernel(Kernel):
    """A kernel whose ringlets and rotation are those in Python."""

    unobserved = staticmethod(defined_ringlet)
    give_turns = DefinedRotation.give_turns
    give_round = DefinedRotation.give_round
    give_rounds = DefinedRotation.give_rounds


class Defined(Arrangement):
    """An arrangement whose ringlets, rotation and timing are those in Python."""

    def __init__(
        self,
        machines: Iterable[Loadable] = (),
        *,
        start_suspended: Iterable[Loadable] = (),
        **how: Any,
    ):
        super().__init__(**how)
        self.kernel.__class__ = DefinedKernel
        self.kernel.bind_all()
        if self.kernel.stopwatch is not None:
            self.kernel.stopwatch.__class__ = DefinedStopwatch
        for machine in machines:
            self.load(machine)
        for machine in start_suspended:
            self.load_suspended(machine)
