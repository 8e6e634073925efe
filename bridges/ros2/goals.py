"""The status of an action's goal."""

from __future__ import annotations

from enum import IntEnum

__all__ = ["GoalStatus"]


class GoalStatus(IntEnum):
    """The states of a goal, numbered as in action_msgs/msg/GoalStatus."""

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
        """Whether a goal has been accepted and has not ended."""
        return GoalStatus.ACCEPTED <= self <= GoalStatus.CANCELING
