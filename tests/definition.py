"""Arrangements that run by the definitions, although the twins in C are there."""

from __future__ import annotations

from llfsm.runtime import Arrangement
from llfsm.runtime.engine import ringlet, rotation, twin

__all__ = ["BUILT", "Defined"]

BUILT = twin.ringlet is not ringlet.ringlet
"""Whether there are twins."""


class Defined(Arrangement):
    """An arrangement whose ringlets and rotation are those in Python."""

    _give_turns = rotation.Rotation._give_turns

    def _bind_all(self) -> None:
        super()._bind_all()
        if self._turn is twin.ringlet:
            self._turn = ringlet.ringlet
