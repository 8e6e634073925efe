"""The messages of ROS's package ``std_msgs``: single values, and the header."""

from llfsm.whiteboard.message import Message
from llfsm.whiteboard.messages import types
from llfsm.whiteboard.messages.builtin_interfaces import Time


class String(Message, type_name="std_msgs/msg/String"):
    """A text."""

    data: str = ""


class Bool(Message, type_name="std_msgs/msg/Bool"):
    """A truth value."""

    data: bool = False


class Byte(Message, type_name="std_msgs/msg/Byte"):
    """Eight bits."""

    data: types.UInt8 = 0


class Char(Message, type_name="std_msgs/msg/Char"):
    """The code of an ASCII character."""

    data: types.UInt8 = 0


class Float32(Message, type_name="std_msgs/msg/Float32"):
    """A number; float32 in ROS."""

    data: float = 0.0


class Float64(Message, type_name="std_msgs/msg/Float64"):
    """A number."""

    data: float = 0.0


class Int8(Message, type_name="std_msgs/msg/Int8"):
    """A signed integer of 8 bits."""

    data: types.Int8 = 0


class Int16(Message, type_name="std_msgs/msg/Int16"):
    """A signed integer of 16 bits."""

    data: types.Int16 = 0


class Int32(Message, type_name="std_msgs/msg/Int32"):
    """A signed integer of 32 bits."""

    data: types.Int32 = 0


class Int64(Message, type_name="std_msgs/msg/Int64"):
    """A signed integer of 64 bits."""

    data: types.Int64 = 0


class UInt8(Message, type_name="std_msgs/msg/UInt8"):
    """An unsigned integer of 8 bits."""

    data: types.UInt8 = 0


class UInt16(Message, type_name="std_msgs/msg/UInt16"):
    """An unsigned integer of 16 bits."""

    data: types.UInt16 = 0


class UInt32(Message, type_name="std_msgs/msg/UInt32"):
    """An unsigned integer of 32 bits."""

    data: types.UInt32 = 0


class UInt64(Message, type_name="std_msgs/msg/UInt64"):
    """An unsigned integer of 64 bits."""

    data: types.UInt64 = 0


class Empty(Message, type_name="std_msgs/msg/Empty"):
    """A message without fields."""


class ColorRGBA(Message, type_name="std_msgs/msg/ColorRGBA"):
    """A colour; each value is 0 to 1, and ``a`` is 0 for transparent. All are float32 in ROS."""

    r: float = 0.0
    g: float = 0.0
    b: float = 0.0
    a: float = 0.0


class Header(Message, type_name="std_msgs/msg/Header"):
    """The time and the frame of coordinates of a message."""

    stamp: Time = Time()
    frame_id: str = ""
