"""An action's goals in slots, one at a time: the machine's own, or those that it serves.

| slot | a client's | a server's |
|---|---|---|
| ``goal`` | machine to bridge: send it | bridge to machine: asked to do it |
| ``cancel`` | machine to bridge | bridge to machine |
| ``status`` | bridge to machine: each change | machine to bridge: accepted, or refused |
| ``feedback`` | bridge to machine | machine to bridge |
| ``result`` | bridge to machine, before the final status | machine to bridge: ends the goal |
"""

from __future__ import annotations

from typing import Any

from msgspec.structs import astuple

from llfsm.runtime.goals import CancelGoal, GoalStanding, GoalStatus
from llfsm.whiteboard import Message, Slot

from ..types import RosAction
from .capacity import capacity_for
from .service_slots import numbered

__all__ = ["ActionSlots", "action_slots"]


class ActionSlots:
    """The slots of an action, and its messages from ROS to them and back.

    Attributes:
        goal: its messages have ``number`` and the fields of the action's goal.
        cancel: :class:`.CancelGoal`.
        status: :class:`.GoalStanding`.
        feedback: ``number`` and the fields of the feedback.
        result: ``number``, the fields of the result, ``status``, and ``failure``, the reason if
            the server did not end it, or empty.

    """

    def __init__(self, name: str, of: RosAction, capacity: int | None) -> None:
        def slot(what: str, cls: type[Any]) -> Slot[Any]:
            return Slot(f"{name}/{what}", cls, capacity or capacity_for(cls))

        self.of = of
        self.goal = slot("goal", numbered(of.goal))
        self.cancel: Slot[CancelGoal] = Slot(f"{name}/cancel", CancelGoal)
        self.status: Slot[GoalStanding] = Slot(f"{name}/status", GoalStanding)
        self.feedback = slot("feedback", numbered(of.feedback))
        self.result = slot("result", numbered(of.result, status=GoalStatus.UNKNOWN, failure=""))

    @property
    def all(self) -> tuple[Slot[Any], ...]:
        """All five."""
        return self.goal, self.cancel, self.status, self.feedback, self.result

    def asked(self, number: int, goal: Message) -> Message:
        """Return a ROS goal as a message of the slot."""
        return self.goal.type(number, *astuple(goal))  # type: ignore[no-any-return]

    def ros_goal(self, asked: Message) -> Message:
        """Return the ROS goal of a message in the slot."""
        return self.of.goal.message(*astuple(asked)[1:])  # type: ignore[no-any-return]

    def slot_feedback(self, number: int, feedback: Message) -> Message:
        """Return ROS feedback as a message of the slot."""
        return self.feedback.type(number, *astuple(feedback))  # type: ignore[no-any-return]

    def ros_feedback(self, message: Message) -> Message:
        """Return the ROS feedback of a message in the slot."""
        return self.of.feedback.message(*astuple(message)[1:])  # type: ignore[no-any-return]

    def ended(self, number: int, status: GoalStatus, result: Message) -> Message:
        """Return a ROS result as a message of the slot."""
        return self.result.type(  # type: ignore[no-any-return]
            number, *astuple(result), status
        )

    def failed(self, number: int, status: GoalStatus, why: str) -> Message:
        """Return the result of a goal that its server did not end."""
        return self.result.type(number=number, status=status, failure=why)  # type: ignore[no-any-return]

    def ros_result(self, ended: Message) -> Message:
        """Return the ROS result of a message in the slot."""
        return self.of.result.message(*astuple(ended)[1:-2])  # type: ignore[no-any-return]


def action_slots(name: str, of: RosAction, capacity: int | None = None) -> ActionSlots:
    """Return the slots ``name/goal``, ``name/cancel`` and so on of an action type.

    A field of the action with the name of one of ours gets an underscore. Raise
    :class:`.SlotNameError`.
    """
    return ActionSlots(name, of, capacity)
