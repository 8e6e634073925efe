"""Whether a goal's machine is lost: its last will, which cancels goals, has been executed.

A guard posts a safe value only in place of a message of the process that has died. On the slot for
cancellations a machine has posted none while it waits for its goal, so the bridge looks itself.
"""

from __future__ import annotations

from contextlib import suppress
from typing import Any

from llfsm.whiteboard import Board, BoundSlot, Sample
from llfsm.whiteboard.errors import BoardClosedError, MessageUnreadableError, SlotError
from llfsm.whiteboard.liveness import writer_lives
from llfsm.whiteboard.messages.llfsm import WILLS, LastWill, will_slot

__all__ = ["SenderWill"]


class SenderWill:
    """The last will of the process that has posted a goal, as far as it cancels goals."""

    def __init__(self, board: Board, goal: Sample[Any], cancels: str) -> None:
        """``cancels`` is the name of the slot for cancellations."""
        self._goal = goal
        self._wills: list[BoundSlot[LastWill]] = []
        for info in board.slots():
            if not info.name.startswith(WILLS):
                continue
            with suppress(SlotError, MessageUnreadableError):  # not a will, whatever its name
                will = board[will_slot(info.name.removeprefix(WILLS))]
                sample = will.sample()
                if sample is None or sample.writer != goal.writer:
                    continue
                if any(value.slot == cancels for value in sample.message.values):
                    self._wills.append(will)

    @property
    def is_executed(self) -> bool:
        """Whether the process has died, or was silent for so long that it counts as dead."""
        return any(self._is_executed(will) for will in self._wills)

    def _is_executed(self, will: BoundSlot[LastWill]) -> bool:
        sample = None
        with suppress(MessageUnreadableError, BoardClosedError):  # or the bridge ends
            sample = will.sample()
        if sample is None:  # withdrawn, and its name given up
            return False
        if sample.message.state == "left" and sample.writer != self._goal.writer:
            return not writer_lives(self._goal)  # a machine has replaced the one that is lost
        return sample.message.state == "executed"
