"""The messages of ROS's package ``builtin_interfaces``: times and durations."""

from llfsm.whiteboard.message import Message
from llfsm.whiteboard.messages.types import Int32, UInt32


class Time(Message, type_name="builtin_interfaces/msg/Time"):
    """A time since the epoch of its clock."""

    sec: Int32 = 0
    nanosec: UInt32 = 0


class Duration(Message, type_name="builtin_interfaces/msg/Duration"):
    """A duration; ``nanosec`` is added to ``sec``, also if that is negative."""

    sec: Int32 = 0
    nanosec: UInt32 = 0
