"""The messages of ROS's package ``geometry_msgs``. Units: metres, radians, seconds."""

from typing import Annotated

from msgspec import Meta

from llfsm.whiteboard.message import Message
from llfsm.whiteboard.messages.std_msgs import Header

Covariance = Annotated[tuple[float, ...], Meta(min_length=36, max_length=36)]


class Vector3(Message, type_name="geometry_msgs/msg/Vector3"):
    """A vector in free space."""

    x: float = 0.0
    y: float = 0.0
    z: float = 0.0


class Point(Message, type_name="geometry_msgs/msg/Point"):
    """A position in space."""

    x: float = 0.0
    y: float = 0.0
    z: float = 0.0


class Quaternion(Message, type_name="geometry_msgs/msg/Quaternion"):
    """An orientation in space; the default is no rotation."""

    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    w: float = 1.0


class Pose(Message, type_name="geometry_msgs/msg/Pose"):
    """A position and an orientation."""

    position: Point = Point()
    orientation: Quaternion = Quaternion()


class Twist(Message, type_name="geometry_msgs/msg/Twist"):
    """Velocity, linear in m/s and angular in rad/s."""

    linear: Vector3 = Vector3()
    angular: Vector3 = Vector3()


class Vector3Stamped(Message, type_name="geometry_msgs/msg/Vector3Stamped"):
    """A vector with a time and a frame of coordinates."""

    header: Header = Header()
    vector: Vector3 = Vector3()


class Point32(Message, type_name="geometry_msgs/msg/Point32"):
    """A position in space; float32 in ROS."""

    x: float = 0.0
    y: float = 0.0
    z: float = 0.0


class PointStamped(Message, type_name="geometry_msgs/msg/PointStamped"):
    """A position with a time and a frame of coordinates."""

    header: Header = Header()
    point: Point = Point()


class Polygon(Message, type_name="geometry_msgs/msg/Polygon"):
    """An area given by its corners; the last one is connected to the first."""

    points: tuple[Point32, ...] = ()


class PolygonStamped(Message, type_name="geometry_msgs/msg/PolygonStamped"):
    """An area with a time and a frame of coordinates."""

    header: Header = Header()
    polygon: Polygon = Polygon()


class PoseStamped(Message, type_name="geometry_msgs/msg/PoseStamped"):
    """A position and an orientation with a time and a frame of coordinates."""

    header: Header = Header()
    pose: Pose = Pose()


class PoseArray(Message, type_name="geometry_msgs/msg/PoseArray"):
    """Poses with a time and a frame of coordinates."""

    header: Header = Header()
    poses: tuple[Pose, ...] = ()


class PoseWithCovariance(Message, type_name="geometry_msgs/msg/PoseWithCovariance"):
    """A pose and its covariance: 6 rows of 6, for x, y, z and the rotations about them."""

    pose: Pose = Pose()
    covariance: Covariance = (0.0,) * 36


class PoseWithCovarianceStamped(Message, type_name="geometry_msgs/msg/PoseWithCovarianceStamped"):
    """A pose and its covariance with a time and a frame of coordinates."""

    header: Header = Header()
    pose: PoseWithCovariance = PoseWithCovariance()


class TwistStamped(Message, type_name="geometry_msgs/msg/TwistStamped"):
    """Velocity with a time and a frame of coordinates."""

    header: Header = Header()
    twist: Twist = Twist()


class TwistWithCovariance(Message, type_name="geometry_msgs/msg/TwistWithCovariance"):
    """Velocity and its covariance: 6 rows of 6, for x, y, z and the rotations about them."""

    twist: Twist = Twist()
    covariance: Covariance = (0.0,) * 36


class TwistWithCovarianceStamped(Message, type_name="geometry_msgs/msg/TwistWithCovarianceStamped"):
    """Velocity and its covariance with a time and a frame of coordinates."""

    header: Header = Header()
    twist: TwistWithCovariance = TwistWithCovariance()


class Accel(Message, type_name="geometry_msgs/msg/Accel"):
    """Acceleration, linear in m/s² and angular in rad/s²."""

    linear: Vector3 = Vector3()
    angular: Vector3 = Vector3()


class Wrench(Message, type_name="geometry_msgs/msg/Wrench"):
    """Force in N and torque in Nm."""

    force: Vector3 = Vector3()
    torque: Vector3 = Vector3()


class Transform(Message, type_name="geometry_msgs/msg/Transform"):
    """A transformation from one frame of coordinates to another."""

    translation: Vector3 = Vector3()
    rotation: Quaternion = Quaternion()


class TransformStamped(Message, type_name="geometry_msgs/msg/TransformStamped"):
    """A transformation from the header's frame of coordinates to the child's, with a time."""

    header: Header = Header()
    child_frame_id: str = ""
    transform: Transform = Transform()
