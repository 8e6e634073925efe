"""What the turtle simulator reports, as ROS's package ``turtlesim`` has it."""

from ..message import Message
from .types import UInt8

__all__ = ["Color", "Pose"]


class Pose(Message, type_name="turtlesim/msg/Pose"):
    """Where a turtle is and how it moves: metres, radians in [-pi, pi], m/s without sign, rad/s.

    All are float32 in ROS; the simulator reports values that float32 holds exactly.
    """

    x: float = 0.0
    y: float = 0.0
    theta: float = 0.0
    linear_velocity: float = 0.0
    angular_velocity: float = 0.0


class Color(Message, type_name="turtlesim/msg/Color"):
    """The colour under a turtle, 0 to 255 each."""

    r: UInt8 = 0
    g: UInt8 = 0
    b: UInt8 = 0
