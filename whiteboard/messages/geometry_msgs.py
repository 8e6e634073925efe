"""Motion and place, as ROS's package ``geometry_msgs`` has them. Metres, radians, seconds."""

from ..message import Message

__all__ = ["Point", "Pose", "Quaternion", "Twist", "Vector3"]


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
    """An orientation in space; the default is none."""

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
