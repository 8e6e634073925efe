"""Navigation2 at home: machines that answer the goals of those in `nav2`, without any ROS.

Each serves one action in the slots in which a bridge would, so a mission runs beside them as on the
robot: in a test with simulated time, in a demonstration, or to be proved. A goal takes as long as
the robot would take. What can go wrong is a variable: set `fails`, `refuses` or `silent` for a goal
that is aborted at its end, one that is not accepted, and a server that is gone.
"""

from __future__ import annotations

from math import hypot
from typing import TYPE_CHECKING, Any, ClassVar

from llfsm.machines.behaviours import POSE
from llfsm.machines.calls import ActionSlots
from llfsm.machines.nav2 import (
    BACK_UP,
    CLEAR_GLOBAL_COSTMAP,
    CLEAR_LOCAL_COSTMAP,
    DOCK_ROBOT,
    DRIVE_ON_HEADING,
    NAVIGATE_TO_POSE,
    SPIN,
    UNDOCK_ROBOT,
    BackUpGoal,
    ClearAnswer,
    ClearRequest,
    DriveOnHeadingGoal,
)
from llfsm.runtime import Actuator, Machine, Sensor, State
from llfsm.runtime.goals import CancelGoal, GoalStanding, GoalStatus

__all__ = [
    "ActionStandIn",
    "BackUpStandIn",
    "ClearCostmapsStandIn",
    "DockStandIn",
    "DriveOnHeadingStandIn",
    "NavigateToStandIn",
    "SpinStandIn",
    "UndockStandIn",
    "answers_of",
]


class ActionStandIn(Machine):
    """Answer the goals of one action; a subclass has the ports, and says how long a goal takes.

    A newer goal ends the one before, as Navigation2 does; a cancellation counts if it is for this
    goal, or for any and has come after it. A restart aborts the goal under way.

    Args:
        fails: abort each goal at its end.
        refuses: accept none.
        silent: answer none.

    """

    if TYPE_CHECKING:
        asked: ClassVar[Any]
        cancel: ClassVar[Any]
        stand: ClassVar[Any]
        give: ClassVar[Any]
    fails: bool = False
    refuses: bool = False
    silent: bool = False
    number: int = 0
    time_s: float = 0.0
    is_canceled: bool = False
    is_open: bool = False

    IDLE = State()
    REFUSED = State()
    EXECUTING = State()
    CANCELED = State()
    ABORTED = State()
    SUCCEEDED = State()

    def seconds(self) -> float:
        """Return the time that the goal takes, 0 or more."""
        raise NotImplementedError  # each action has its own

    def reach(self) -> None:
        """Do what is done when a goal is reached."""

    def is_new(self) -> bool:
        """True if a goal has come, and there is an answer to it."""
        return not self.silent and self.asked is not None and self.asked.number > self.number

    def end(self, status: GoalStatus) -> None:
        """Post how the goal has ended: the result before the status, as a bridge does."""
        self.is_open = False
        self.give(type(self).give.slot.type(self.number, status=status))
        self.stand(GoalStanding(self.number, status))

    @REFUSED.on_entry
    def _(self) -> None:
        self.number = self.asked.number
        self.stand(GoalStanding(self.number, GoalStatus.REFUSED, "the stand-in refuses goals"))

    @EXECUTING.on_entry
    def _(self) -> None:
        self.number, self.time_s = self.asked.number, self.seconds()
        self.is_canceled, self.is_open = False, True
        self.stand(GoalStanding(self.number, GoalStatus.EXECUTING))

    @EXECUTING.internal
    def _(self) -> None:
        if self.cancel is not None:
            of_goal, of_cancel = self.age_ms("asked"), self.age_ms("cancel")
            came_later = of_goal is not None and of_cancel is not None and of_cancel < of_goal
            is_for_any = self.cancel.number == 0 and came_later
            self.is_canceled = is_for_any or self.cancel.number == self.number

    @CANCELED.on_entry
    def _(self) -> None:
        self.end(GoalStatus.CANCELED)

    @ABORTED.on_entry
    def _(self) -> None:
        self.end(GoalStatus.ABORTED)

    @SUCCEEDED.on_entry
    def _(self) -> None:
        self.reach()
        self.end(GoalStatus.SUCCEEDED)

    IDLE.to(ABORTED, when=lambda self: self.is_open)
    IDLE.to(REFUSED, when=lambda self: self.is_new() and self.refuses)
    IDLE.to(EXECUTING, when=is_new)
    EXECUTING.to(CANCELED, when=lambda self: self.is_canceled)
    EXECUTING.to(ABORTED, when=is_new)
    EXECUTING.to(ABORTED, when=lambda self: self.fails and self.after(self.time_s))
    EXECUTING.to(SUCCEEDED, when=lambda self: self.after(self.time_s))
    REFUSED.to(IDLE)
    CANCELED.to(IDLE)
    ABORTED.to(IDLE)
    SUCCEEDED.to(IDLE)


def answers_of(action: ActionSlots) -> tuple[Any, Any, Actuator[GoalStanding], Actuator[Any]]:
    """Make the ports `asked`, `cancel`, `stand` and `give` of an `ActionStandIn`."""
    cancel: Sensor[CancelGoal, None] = Sensor(action.cancel, since_start=True)
    asked = Sensor(action.goal, since_start=True)
    return asked, cancel, Actuator(action.status), Actuator(action.result)


class NavigateToStandIn(ActionStandIn):
    """Be at each pose after the time that a straight way takes at `speed` m/s, and post it.

    Args:
        x: where the robot is, in metres; `y` likewise.
        speed: m/s.

    """

    asked, cancel, stand, give = answers_of(NAVIGATE_TO_POSE)
    pose = Actuator(POSE)
    x: float = 0.0
    y: float = 0.0
    speed: float = 0.5

    def seconds(self) -> float:
        """Return the time for the straight way."""
        there = self.asked.pose.pose.position
        return hypot(there.x - self.x, there.y - self.y) / self.speed

    def reach(self) -> None:
        """Be there."""
        self.x, self.y = self.asked.pose.pose.position.x, self.asked.pose.pose.position.y
        self.pose(self.asked.pose)


class SpinStandIn(ActionStandIn):
    """Take a second for each radian."""

    asked, cancel, stand, give = answers_of(SPIN)

    def seconds(self) -> float:
        """Return the time for the turn."""
        return abs(float(self.asked.target_yaw))


def _way_s(goal: BackUpGoal | DriveOnHeadingGoal) -> float:
    """Return the time for the way of a goal at its speed, which is 1 cm/s at least."""
    return abs(goal.target.x) / max(abs(goal.speed), 0.01)


class BackUpStandIn(ActionStandIn):
    """Take the time of the way at the goal's speed."""

    asked, cancel, stand, give = answers_of(BACK_UP)

    def seconds(self) -> float:
        """Return the time for the way."""
        return _way_s(self.asked)


class DriveOnHeadingStandIn(ActionStandIn):
    """Take the time of the way at the goal's speed."""

    asked, cancel, stand, give = answers_of(DRIVE_ON_HEADING)

    def seconds(self) -> float:
        """Return the time for the way."""
        return _way_s(self.asked)


class DockStandIn(ActionStandIn):
    """Dock within `takes` seconds."""

    asked, cancel, stand, give = answers_of(DOCK_ROBOT)
    takes: float = 10.0

    def seconds(self) -> float:
        """Return the time for the docking."""
        return self.takes


class UndockStandIn(ActionStandIn):
    """Leave the dock within `takes` seconds."""

    asked, cancel, stand, give = answers_of(UNDOCK_ROBOT)
    takes: float = 3.0

    def seconds(self) -> float:
        """Return the time for the way out."""
        return self.takes


class ClearCostmapsStandIn(Machine):
    """Clear both costmaps at once, as nothing is in them."""

    everywhere = Sensor(CLEAR_GLOBAL_COSTMAP.request, default=ClearRequest(), since_start=True)
    nearby = Sensor(CLEAR_LOCAL_COSTMAP.request, default=ClearRequest(), since_start=True)
    cleared_everywhere = Actuator(CLEAR_GLOBAL_COSTMAP.answer)
    cleared_nearby = Actuator(CLEAR_LOCAL_COSTMAP.answer)
    silent: bool = False
    last_everywhere: int = 0
    last_nearby: int = 0

    READY = State()
    EVERYWHERE = State()
    NEARBY = State()

    @EVERYWHERE.on_entry
    def _(self) -> None:
        self.last_everywhere = self.everywhere.number
        self.cleared_everywhere(ClearAnswer(self.last_everywhere))

    @NEARBY.on_entry
    def _(self) -> None:
        self.last_nearby = self.nearby.number
        self.cleared_nearby(ClearAnswer(self.last_nearby))

    READY.to(
        EVERYWHERE,
        when=lambda self: not self.silent and self.everywhere.number > self.last_everywhere,
    )
    READY.to(NEARBY, when=lambda self: not self.silent and self.nearby.number > self.last_nearby)
    EVERYWHERE.to(READY)
    NEARBY.to(READY)
