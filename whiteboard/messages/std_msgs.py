"""Single values, as ROS's package ``std_msgs`` has them."""

from ..message import Message
from . import types

__all__ = ["Bool", "Empty", "Float64", "Int32", "Int64", "String"]


class String(Message, type_name="std_msgs/msg/String"):
    """A text."""

    data: str = ""


class Bool(Message, type_name="std_msgs/msg/Bool"):
    """A truth value."""

    data: bool = False


class Float64(Message, type_name="std_msgs/msg/Float64"):
    """A number."""

    data: float = 0.0


class Int32(Message, type_name="std_msgs/msg/Int32"):
    """A whole number of 32 bits."""

    data: types.Int32 = 0


class Int64(Message, type_name="std_msgs/msg/Int64"):
    """A whole number of 64 bits."""

    data: types.Int64 = 0


class Empty(Message, type_name="std_msgs/msg/Empty"):
    """Nothing but that it was sent."""
