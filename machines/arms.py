"""Arms and grippers, as machines for states to run: move there, grip.

They send goals to the actions of ros2_control's controllers, as the machines in `nav2` do to Nav2.
Units are those of `control_msgs`: radians or metres for joints, metres and newtons for grippers.
"""

from __future__ import annotations

from typing import Any

from llfsm.machines.calls import ActionSlots, GoalCaller, ports_of
from llfsm.machines.nav2 import duration
from llfsm.runtime.goals import GoalStatus
from llfsm.whiteboard import Message
from llfsm.whiteboard.messages.builtin_interfaces import Duration
from llfsm.whiteboard.messages.geometry_msgs import Transform, Twist
from llfsm.whiteboard.messages.std_msgs import Header
from llfsm.whiteboard.messages.types import Int32, UInt16

__all__ = [
    "FOLLOW_JOINT_TRAJECTORY",
    "GRIPPER_COMMAND",
    "FollowJointTrajectory",
    "MoveGripper",
]

Floats = tuple[float, ...]


class JointTrajectoryPoint(Message, type_name="trajectory_msgs/msg/JointTrajectoryPoint"):
    """The joints at a time after the start, one number a joint."""

    positions: Floats = ()
    velocities: Floats = ()
    accelerations: Floats = ()
    effort: Floats = ()
    time_from_start: Duration = Duration()


class JointTrajectory(Message, type_name="trajectory_msgs/msg/JointTrajectory"):
    """The names of joints, and where they are to be."""

    header: Header = Header()
    joint_names: tuple[str, ...] = ()
    points: tuple[JointTrajectoryPoint, ...] = ()


class MultiDOFJointTrajectoryPoint(
    Message, type_name="trajectory_msgs/msg/MultiDOFJointTrajectoryPoint"
):
    """As `JointTrajectoryPoint`, for joints with several degrees of freedom."""

    transforms: tuple[Transform, ...] = ()
    velocities: tuple[Twist, ...] = ()
    accelerations: tuple[Twist, ...] = ()
    time_from_start: Duration = Duration()


class MultiDOFJointTrajectory(Message, type_name="trajectory_msgs/msg/MultiDOFJointTrajectory"):
    """As `JointTrajectory`, for joints with several degrees of freedom."""

    header: Header = Header()
    joint_names: tuple[str, ...] = ()
    points: tuple[MultiDOFJointTrajectoryPoint, ...] = ()


class JointTolerance(Message, type_name="control_msgs/msg/JointTolerance"):
    """The tolerance of a joint; 0: as the controller has it, -1: any."""

    name: str = ""
    position: float = 0.0
    velocity: float = 0.0
    acceleration: float = 0.0


class JointComponentTolerance(Message, type_name="control_msgs/msg/JointComponentTolerance"):
    """The tolerance of one component of a joint with several degrees of freedom."""

    joint_name: str = ""
    component: UInt16 = 0
    position: float = 0.0
    velocity: float = 0.0
    acceleration: float = 0.0


class FollowJointTrajectoryGoal(
    Message, type_name="control_msgs/action/FollowJointTrajectory_Goal"
):
    """The way of the joints, and its tolerances."""

    number: int = 0
    trajectory: JointTrajectory = JointTrajectory()
    multi_dof_trajectory: MultiDOFJointTrajectory = MultiDOFJointTrajectory()
    path_tolerance: tuple[JointTolerance, ...] = ()
    component_path_tolerance: tuple[JointComponentTolerance, ...] = ()
    goal_tolerance: tuple[JointTolerance, ...] = ()
    component_goal_tolerance: tuple[JointComponentTolerance, ...] = ()
    goal_time_tolerance: Duration = Duration()


class FollowJointTrajectoryFeedback(
    Message, type_name="control_msgs/action/FollowJointTrajectory_Feedback"
):
    """The joints as they are to be, as they are, and the difference."""

    number: int = 0
    header: Header = Header()
    joint_names: tuple[str, ...] = ()
    desired: JointTrajectoryPoint = JointTrajectoryPoint()
    actual: JointTrajectoryPoint = JointTrajectoryPoint()
    error: JointTrajectoryPoint = JointTrajectoryPoint()
    multi_dof_joint_names: tuple[str, ...] = ()
    multi_dof_desired: MultiDOFJointTrajectoryPoint = MultiDOFJointTrajectoryPoint()
    multi_dof_actual: MultiDOFJointTrajectoryPoint = MultiDOFJointTrajectoryPoint()
    multi_dof_error: MultiDOFJointTrajectoryPoint = MultiDOFJointTrajectoryPoint()


class FollowJointTrajectoryResult(
    Message, type_name="control_msgs/action/FollowJointTrajectory_Result"
):
    """The reason of a failure."""

    number: int = 0
    error_code: Int32 = 0
    error_string: str = ""
    status: GoalStatus = GoalStatus.UNKNOWN
    failure: str = ""


class GripperCommand(Message, type_name="control_msgs/msg/GripperCommand"):
    """The gap in metres, and the greatest force in newtons."""

    position: float = 0.0
    max_effort: float = 0.0


class GripperCommandGoal(Message, type_name="control_msgs/action/GripperCommand_Goal"):
    """The fingers as they are to be."""

    number: int = 0
    command: GripperCommand = GripperCommand()


class GripperCommandFeedback(Message, type_name="control_msgs/action/GripperCommand_Feedback"):
    """The fingers and their force."""

    number: int = 0
    position: float = 0.0
    effort: float = 0.0
    stalled: bool = False
    reached_goal: bool = False


class GripperCommandResult(Message, type_name="control_msgs/action/GripperCommand_Result"):
    """The fingers: at the goal, or stalled, as when they hold something."""

    number: int = 0
    position: float = 0.0
    effort: float = 0.0
    stalled: bool = False
    reached_goal: bool = False
    status: GoalStatus = GoalStatus.UNKNOWN
    failure: str = ""


FOLLOW_JOINT_TRAJECTORY = ActionSlots.of(
    "joint_trajectory_controller/follow_joint_trajectory",
    FollowJointTrajectoryGoal,
    FollowJointTrajectoryFeedback,
    FollowJointTrajectoryResult,
)
GRIPPER_COMMAND = ActionSlots.of(
    "gripper_controller/gripper_cmd",
    GripperCommandGoal,
    GripperCommandFeedback,
    GripperCommandResult,
)


class FollowJointTrajectory(GoalCaller):
    """Move joints from point to point of a trajectory.

    Args:
        joint_names: the joints, in the order of the numbers of each point.
        positions: radians or metres, a tuple of joints for each point.
        times: the seconds from the start at which each point is to be reached.
        goal_time_tolerance: by how many seconds the last one may be late; 0: the controller's.

    """

    send, cancel, sent, standing, result = ports_of(FOLLOW_JOINT_TRAJECTORY)
    joint_names: tuple[str, ...] = ()
    positions: tuple[tuple[float, ...], ...] = ()
    times: tuple[float, ...] = ()
    goal_time_tolerance: float = 0.0

    def goal(self, number: int) -> Message:
        """Make the goal; raise `ValueError` for a point without a time or a joint."""
        points = tuple(
            JointTrajectoryPoint(each, time_from_start=duration(time))
            for each, time in zip(self.positions, self.times, strict=True)
        )
        for number_, point in enumerate(points):
            if len(point.positions) != len(self.joint_names):
                raise ValueError(
                    f"positions[{number_}] has {len(point.positions)} numbers, for "
                    f"{len(self.joint_names)} joints"
                )
        return FollowJointTrajectoryGoal(
            number,
            JointTrajectory(joint_names=self.joint_names, points=points),
            goal_time_tolerance=duration(self.goal_time_tolerance),
        )

    def reason(self, result: Any) -> str:
        """Return the controller's reason."""
        number = f"error {result.error_code}" if result.error_code else ""
        return f"{result.error_string} ({number})" if result.error_string else number


class MoveGripper(GoalCaller):
    """Open or close a gripper to a gap of `position` metres, with `max_effort` newtons at most."""

    send, cancel, sent, standing, result = ports_of(GRIPPER_COMMAND)
    position: float = 0.0
    max_effort: float = 0.0
    timeout_s: float = 20.0

    def goal(self, number: int) -> Message:
        """Make the goal."""
        return GripperCommandGoal(number, GripperCommand(self.position, self.max_effort))

    def reason(self, result: Any) -> str:
        """Return the position of the fingers."""
        how = " (stalled)" if result.stalled else ""
        return f"the fingers are at {result.position:g} m{how}"
