"""The messages of ROS's package ``turtlesim``."""

from llfsm.whiteboard.message import Message
from llfsm.whiteboard.messages.types import UInt8


class Pose(Message, type_name="turtlesim/msg/Pose"):
    """A turtle's pose and velocity: metres, radians in [-pi, pi], m/s without sign, rad/s.

    All are float32 in ROS; the simulator reports values that float32 holds exactly.
    """

    x: float = 0.0
    y: float = 0.0
    theta: float = 0.0
    linear_velocity: float = 0.0
    angular_velocity: float = 0.0


class Color(Message, type_name="turtlesim/msg/Color"):
    """The colour under a turtle; each value is 0 to 255."""

    r: UInt8 = 0
    g: UInt8 = 0
    b: UInt8 = 0
