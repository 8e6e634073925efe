"""Time, as ROS's package ``builtin_interfaces`` has it."""

from ..message import Message
from .types import Int32, UInt32

__all__ = ["Duration", "Time"]


class Time(Message, type_name="builtin_interfaces/msg/Time"):
    """A point in time, since the epoch of whatever clock it is of."""

    sec: Int32 = 0
    nanosec: UInt32 = 0


class Duration(Message, type_name="builtin_interfaces/msg/Duration"):
    """A span of time; ``nanosec`` counts forward from ``sec``, also if that is negative."""

    sec: Int32 = 0
    nanosec: UInt32 = 0
