"""Goals of actions, for the machines that send or serve them: their status, and what cancels them.

A bridge connects the slots of an action with ROS; see docs/how-to/ros2-actions.md. A goal is known
by its number: that of a new goal is higher than those before.
"""

from __future__ import annotations

from enum import IntEnum

from llfsm.whiteboard import Message

__all__ = ["CancelGoal", "GoalStanding", "GoalStatus"]


class GoalStatus(IntEnum):
    """The states of a goal, numbered as in action_msgs/msg/GoalStatus; REFUSED is not in ROS."""

    REFUSED = -1
    """It was not accepted, or could not be sent."""
    UNKNOWN = 0
    """The answer about a goal that the server does not know, or no longer."""
    ACCEPTED = 1
    EXECUTING = 2
    CANCELING = 3
    SUCCEEDED = 4
    CANCELED = 5
    ABORTED = 6

    @property
    def active(self) -> bool:
        """True if a goal has been accepted and has not ended."""
        return GoalStatus.ACCEPTED <= self <= GoalStatus.CANCELING

    @property
    def final(self) -> bool:
        """True if a goal that was accepted has ended."""
        return self >= GoalStatus.SUCCEEDED


class GoalStanding(Message, type_name="llfsm/GoalStanding"):
    """The status of the goal with a number, and the reason if it was not ended by its server."""

    number: int = 0
    status: GoalStatus = GoalStatus.UNKNOWN
    failure: str = ""

    def has_succeeded(self, number: int) -> bool:
        """Return True if the goal with that number has succeeded: its result is there."""
        return self.number == number and self.status is GoalStatus.SUCCEEDED

    def has_failed(self, number: int) -> bool:
        """Return True if the goal with that number was refused, canceled or aborted."""
        ended = self.status.final or self.status is GoalStatus.REFUSED
        return self.number == number and ended and self.status is not GoalStatus.SUCCEEDED


class CancelGoal(Message, type_name="llfsm/CancelGoal"):
    """Cancel the goal with a number; 0: whichever is active, as for a machine that stops."""

    number: int = 0
