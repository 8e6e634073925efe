"""Navigation2, as machines for states to run: go there, turn, back up, dock, clear.

Each sends one goal of one of Nav2's actions, is done when that has succeeded, and fails with Nav2's
reason. Whoever leaves the state that runs it, suspends it or kills its process cancels the goal.
Names, fields and units are Nav2's own (Jazzy): metres, radians, seconds. The slots are those that a
bridge makes of the actions' types, under the names that Nav2 gives them, so no ROS is needed to
load, simulate or prove these machines.
"""

from __future__ import annotations

from math import cos, sin

from llfsm.machines.calls import ActionSlots, CallService, GoalCaller, ServiceSlots, ports_of
from llfsm.machines.combinators import Sequence
from llfsm.runtime.goals import GoalStatus
from llfsm.whiteboard import Message
from llfsm.whiteboard.messages.builtin_interfaces import Duration
from llfsm.whiteboard.messages.geometry_msgs import Point, Pose, PoseStamped, Quaternion
from llfsm.whiteboard.messages.std_msgs import Empty, Header
from llfsm.whiteboard.messages.types import Int16, UInt16, UInt32

__all__ = [
    "ASSISTED_TELEOP",
    "BACK_UP",
    "CLEAR_GLOBAL_COSTMAP",
    "CLEAR_LOCAL_COSTMAP",
    "DOCK_ROBOT",
    "DRIVE_ON_HEADING",
    "FOLLOW_WAYPOINTS",
    "NAVIGATE_TO_POSE",
    "SPIN",
    "UNDOCK_ROBOT",
    "AssistedTeleop",
    "BackUp",
    "ClearCostmaps",
    "ClearRequest",
    "Dock",
    "DriveOnHeading",
    "FollowWaypoints",
    "NavigateTo",
    "Spin",
    "Undock",
    "duration",
    "pose_on",
]

# The messages in the slots: a number, then the fields of Nav2's.


class NavigateToPoseGoal(Message, type_name="nav2_msgs/action/NavigateToPose_Goal"):
    """A pose to go to; `behavior_tree` is a file of the navigator's, "" for its default."""

    number: int = 0
    pose: PoseStamped = PoseStamped()
    behavior_tree: str = ""


class NavigateToPoseFeedback(Message, type_name="nav2_msgs/action/NavigateToPose_Feedback"):
    """The progress of the robot."""

    number: int = 0
    current_pose: PoseStamped = PoseStamped()
    navigation_time: Duration = Duration()
    estimated_time_remaining: Duration = Duration()
    number_of_recoveries: Int16 = 0
    distance_remaining: float = 0.0


class NavigateToPoseResult(Message, type_name="nav2_msgs/action/NavigateToPose_Result"):
    """The reason of a failure."""

    number: int = 0
    error_code: UInt16 = 0
    error_msg: str = ""
    status: GoalStatus = GoalStatus.UNKNOWN
    failure: str = ""


class FollowWaypointsGoal(Message, type_name="nav2_msgs/action/FollowWaypoints_Goal"):
    """Poses to go to in turn, how often again, and with which one to begin."""

    number: int = 0
    number_of_loops: UInt32 = 0
    goal_index: UInt32 = 0
    poses: tuple[PoseStamped, ...] = ()


class FollowWaypointsFeedback(Message, type_name="nav2_msgs/action/FollowWaypoints_Feedback"):
    """The index of the waypoint to which the robot is on its way."""

    number: int = 0
    current_waypoint: UInt32 = 0


class MissedWaypoint(Message, type_name="nav2_msgs/msg/MissedWaypoint"):
    """A waypoint that was not reached, and why."""

    index: UInt32 = 0
    goal: PoseStamped = PoseStamped()
    error_code: UInt16 = 0


class FollowWaypointsResult(Message, type_name="nav2_msgs/action/FollowWaypoints_Result"):
    """The waypoints that were not reached."""

    number: int = 0
    missed_waypoints: tuple[MissedWaypoint, ...] = ()
    error_code: UInt16 = 0
    error_msg: str = ""
    status: GoalStatus = GoalStatus.UNKNOWN
    failure: str = ""


class BackUpGoal(Message, type_name="nav2_msgs/action/BackUp_Goal"):
    """A distance, a speed, and the longest time."""

    number: int = 0
    target: Point = Point()
    speed: float = 0.0
    time_allowance: Duration = Duration()


class DriveOnHeadingGoal(Message, type_name="nav2_msgs/action/DriveOnHeading_Goal"):
    """A distance, a speed, and the longest time."""

    number: int = 0
    target: Point = Point()
    speed: float = 0.0
    time_allowance: Duration = Duration()


class SpinGoal(Message, type_name="nav2_msgs/action/Spin_Goal"):
    """By which angle, and for how long at most."""

    number: int = 0
    target_yaw: float = 0.0
    time_allowance: Duration = Duration()


class AssistedTeleopGoal(Message, type_name="nav2_msgs/action/AssistedTeleop_Goal"):
    """For how long a person drives."""

    number: int = 0
    time_allowance: Duration = Duration()


class BackUpFeedback(Message, type_name="nav2_msgs/action/BackUp_Feedback"):
    """The distance so far."""

    number: int = 0
    distance_traveled: float = 0.0


class DriveOnHeadingFeedback(Message, type_name="nav2_msgs/action/DriveOnHeading_Feedback"):
    """The distance so far."""

    number: int = 0
    distance_traveled: float = 0.0


class SpinFeedback(Message, type_name="nav2_msgs/action/Spin_Feedback"):
    """By which angle the robot has turned."""

    number: int = 0
    angular_distance_traveled: float = 0.0


class AssistedTeleopFeedback(Message, type_name="nav2_msgs/action/AssistedTeleop_Feedback"):
    """For how long the person has driven."""

    number: int = 0
    current_teleop_duration: Duration = Duration()


class _TimedResult(Message):
    """The time that a behaviour took, and why it failed, if it did."""

    number: int = 0
    total_elapsed_time: Duration = Duration()
    error_code: UInt16 = 0
    error_msg: str = ""
    status: GoalStatus = GoalStatus.UNKNOWN
    failure: str = ""


class BackUpResult(_TimedResult, type_name="nav2_msgs/action/BackUp_Result"):
    """The time that it took, and why it failed, if it did."""


class DriveOnHeadingResult(_TimedResult, type_name="nav2_msgs/action/DriveOnHeading_Result"):
    """The time that it took, and why it failed, if it did."""


class SpinResult(_TimedResult, type_name="nav2_msgs/action/Spin_Result"):
    """The time that it took, and why it failed, if it did."""


class AssistedTeleopResult(_TimedResult, type_name="nav2_msgs/action/AssistedTeleop_Result"):
    """The time that it took, and why it failed, if it did."""


class DockRobotGoal(Message, type_name="nav2_msgs/action/DockRobot_Goal"):
    """A dock: by its name, or by its pose and type."""

    number: int = 0
    use_dock_id: bool = True
    dock_id: str = ""
    dock_pose: PoseStamped = PoseStamped()
    dock_type: str = ""
    max_staging_time: float = 1000.0
    navigate_to_staging_pose: bool = True


class DockRobotFeedback(Message, type_name="nav2_msgs/action/DockRobot_Feedback"):
    """The progress: 1 on the way, 2 looking, 3 approaching, 4 waiting for charge, 5 again."""

    number: int = 0
    state: UInt16 = 0
    docking_time: Duration = Duration()
    num_retries: UInt16 = 0


class DockRobotResult(Message, type_name="nav2_msgs/action/DockRobot_Result"):
    """The end of the docking, the number of tries, and the reason of a failure."""

    number: int = 0
    success: bool = True
    error_code: UInt16 = 0
    num_retries: UInt16 = 0
    error_msg: str = ""
    status: GoalStatus = GoalStatus.UNKNOWN
    failure: str = ""


class UndockRobotGoal(Message, type_name="nav2_msgs/action/UndockRobot_Goal"):
    """From which type of dock, and for how long at most."""

    number: int = 0
    dock_type: str = ""
    max_undocking_time: float = 30.0


class UndockRobotFeedback(Message, type_name="nav2_msgs/action/UndockRobot_Feedback"):
    """Nothing: there is none."""

    number: int = 0


class UndockRobotResult(Message, type_name="nav2_msgs/action/UndockRobot_Result"):
    """The end of the undocking, and the reason of a failure."""

    number: int = 0
    success: bool = True
    error_code: UInt16 = 0
    error_msg: str = ""
    status: GoalStatus = GoalStatus.UNKNOWN
    failure: str = ""


class ClearRequest(Message, type_name="nav2_msgs/srv/ClearEntireCostmap_Request"):
    """Clear a costmap."""

    number: int = 0
    request: Empty = Empty()


class ClearAnswer(Message, type_name="nav2_msgs/srv/ClearEntireCostmap_Response"):
    """It was cleared, unless there is a `failure`."""

    number: int = 0
    response: Empty = Empty()
    failure: str = ""


NAVIGATE_TO_POSE = ActionSlots.of(
    "navigate_to_pose", NavigateToPoseGoal, NavigateToPoseFeedback, NavigateToPoseResult
)
FOLLOW_WAYPOINTS = ActionSlots.of(
    "follow_waypoints", FollowWaypointsGoal, FollowWaypointsFeedback, FollowWaypointsResult
)
BACK_UP = ActionSlots.of("backup", BackUpGoal, BackUpFeedback, BackUpResult)
DRIVE_ON_HEADING = ActionSlots.of(
    "drive_on_heading", DriveOnHeadingGoal, DriveOnHeadingFeedback, DriveOnHeadingResult
)
SPIN = ActionSlots.of("spin", SpinGoal, SpinFeedback, SpinResult)
ASSISTED_TELEOP = ActionSlots.of(
    "assisted_teleop", AssistedTeleopGoal, AssistedTeleopFeedback, AssistedTeleopResult
)
DOCK_ROBOT = ActionSlots.of("dock_robot", DockRobotGoal, DockRobotFeedback, DockRobotResult)
UNDOCK_ROBOT = ActionSlots.of(
    "undock_robot", UndockRobotGoal, UndockRobotFeedback, UndockRobotResult
)


CLEAR_GLOBAL_COSTMAP, CLEAR_LOCAL_COSTMAP = (
    ServiceSlots.of(f"{which}_costmap/clear_entirely_{which}_costmap", ClearRequest, ClearAnswer)
    for which in ("global", "local")
)


def pose_on(frame_id: str, x: float, y: float, yaw: float = 0.0) -> PoseStamped:
    """Make a pose in metres and radians; without a time, which is "now" for Nav2."""
    turned = Quaternion(z=sin(yaw / 2), w=cos(yaw / 2))
    return PoseStamped(Header(frame_id=frame_id), Pose(Point(x, y), turned))


def duration(seconds: float) -> Duration:
    """Make ROS's duration of seconds, 0 or more."""
    whole = int(seconds)
    return Duration(whole, round((seconds - whole) * 1e9))


class NavigateTo(GoalCaller):
    """Navigate to a pose. How far it is, is in the slot ``navigate_to_pose/feedback``.

    Args:
        x: metres, in `frame_id`; `y` likewise.
        yaw: the heading there, in radians.
        behavior_tree: a file of the navigator's; "" for its default.

    """

    send, cancel, sent, standing, result = ports_of(NAVIGATE_TO_POSE)
    x: float = 0.0
    y: float = 0.0
    yaw: float = 0.0
    frame_id: str = "map"
    behavior_tree: str = ""
    timeout_s: float = 600.0

    def goal(self, number: int) -> Message:
        """Make the goal."""
        pose = pose_on(self.frame_id, self.x, self.y, self.yaw)
        return NavigateToPoseGoal(number, pose, self.behavior_tree)


class FollowWaypoints(GoalCaller):
    """Go from waypoint to waypoint. Those that were missed are in ``follow_waypoints/result``.

    Args:
        waypoints: x and y in metres and the heading in radians of each, in `frame_id`.
        number_of_loops: how often to go again after the first time.

    """

    send, cancel, sent, standing, result = ports_of(FOLLOW_WAYPOINTS)
    waypoints: tuple[tuple[float, float, float], ...] = ()
    number_of_loops: int = 0
    frame_id: str = "map"
    timeout_s: float = 3600.0

    def goal(self, number: int) -> Message:
        """Make the goal."""
        poses = tuple(pose_on(self.frame_id, *each) for each in self.waypoints)
        return FollowWaypointsGoal(number, self.number_of_loops, 0, poses)


class BackUp(GoalCaller):
    """Drive backwards by `distance` metres at `speed` m/s."""

    send, cancel, sent, standing, result = ports_of(BACK_UP)
    distance: float = 0.15
    speed: float = 0.05
    time_allowance: float = 10.0

    def goal(self, number: int) -> Message:
        """Make the goal."""
        return BackUpGoal(number, Point(self.distance), self.speed, duration(self.time_allowance))


class DriveOnHeading(GoalCaller):
    """Drive straight on by `distance` metres at `speed` m/s."""

    send, cancel, sent, standing, result = ports_of(DRIVE_ON_HEADING)
    distance: float = 0.15
    speed: float = 0.05
    time_allowance: float = 10.0

    def goal(self, number: int) -> Message:
        """Make the goal."""
        target, allowance = Point(self.distance), duration(self.time_allowance)
        return DriveOnHeadingGoal(number, target, self.speed, allowance)


class Spin(GoalCaller):
    """Turn on the spot by `target_yaw` radians."""

    send, cancel, sent, standing, result = ports_of(SPIN)
    target_yaw: float = 1.57
    time_allowance: float = 10.0

    def goal(self, number: int) -> Message:
        """Make the goal."""
        return SpinGoal(number, self.target_yaw, duration(self.time_allowance))


class AssistedTeleop(GoalCaller):
    """Let a person drive for `time_allowance` seconds, kept from collisions by Nav2."""

    send, cancel, sent, standing, result = ports_of(ASSISTED_TELEOP)
    time_allowance: float = 10.0

    def goal(self, number: int) -> Message:
        """Make the goal."""
        return AssistedTeleopGoal(number, duration(self.time_allowance))


class Dock(GoalCaller):
    """Drive to a dock and charge there: the one called `dock_id`, or one of `dock_type` at a pose.

    Args:
        dock_id: its name among the docks of the server; with "", `x`, `y`, `yaw` and `dock_type`.

    """

    send, cancel, sent, standing, result = ports_of(DOCK_ROBOT)
    dock_id: str = ""
    x: float = 0.0
    y: float = 0.0
    yaw: float = 0.0
    frame_id: str = "map"
    dock_type: str = ""
    navigate_to_staging_pose: bool = True
    timeout_s: float = 1200.0

    def goal(self, number: int) -> Message:
        """Make the goal."""
        return DockRobotGoal(
            number,
            self.dock_id != "",
            self.dock_id,
            pose_on(self.frame_id, self.x, self.y, self.yaw),
            self.dock_type,
            navigate_to_staging_pose=self.navigate_to_staging_pose,
        )


class Undock(GoalCaller):
    """Leave the dock."""

    send, cancel, sent, standing, result = ports_of(UNDOCK_ROBOT)
    dock_type: str = ""
    max_undocking_time: float = 30.0

    def goal(self, number: int) -> Message:
        """Make the goal."""
        return UndockRobotGoal(number, self.dock_type, self.max_undocking_time)


ClearCostmaps = Sequence(
    CallService(CLEAR_GLOBAL_COSTMAP, ClearRequest(), name="ClearGlobalCostmap"),
    CallService(CLEAR_LOCAL_COSTMAP, ClearRequest(), name="ClearLocalCostmap"),
    name="ClearCostmaps",
)
"""Forget all obstacles in both costmaps, so that the robot looks again."""
