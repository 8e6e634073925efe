"""Single values, as ROS's package ``std_msgs`` has them; and the header of a stamped message."""

from ..message import Message
from . import types
from .builtin_interfaces import Time

__all__ = [
    "Bool",
    "Byte",
    "Char",
    "ColorRGBA",
    "Empty",
    "Float32",
    "Float64",
    "Header",
    "Int8",
    "Int16",
    "Int32",
    "Int64",
    "String",
    "UInt8",
    "UInt16",
    "UInt32",
    "UInt64",
]


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
    """A character of ASCII, as its number."""

    data: types.UInt8 = 0


class Float32(Message, type_name="std_msgs/msg/Float32"):
    """A number, which ROS rounds to single precision."""

    data: float = 0.0


class Float64(Message, type_name="std_msgs/msg/Float64"):
    """A number."""

    data: float = 0.0


class Int8(Message, type_name="std_msgs/msg/Int8"):
    """A whole number of 8 bits."""

    data: types.Int8 = 0


class Int16(Message, type_name="std_msgs/msg/Int16"):
    """A whole number of 16 bits."""

    data: types.Int16 = 0


class Int32(Message, type_name="std_msgs/msg/Int32"):
    """A whole number of 32 bits."""

    data: types.Int32 = 0


class Int64(Message, type_name="std_msgs/msg/Int64"):
    """A whole number of 64 bits."""

    data: types.Int64 = 0


class UInt8(Message, type_name="std_msgs/msg/UInt8"):
    """A whole number of 8 bits without a sign."""

    data: types.UInt8 = 0


class UInt16(Message, type_name="std_msgs/msg/UInt16"):
    """A whole number of 16 bits without a sign."""

    data: types.UInt16 = 0


class UInt32(Message, type_name="std_msgs/msg/UInt32"):
    """A whole number of 32 bits without a sign."""

    data: types.UInt32 = 0


class UInt64(Message, type_name="std_msgs/msg/UInt64"):
    """A whole number of 64 bits without a sign."""

    data: types.UInt64 = 0


class Empty(Message, type_name="std_msgs/msg/Empty"):
    """Nothing but that it was sent."""


class ColorRGBA(Message, type_name="std_msgs/msg/ColorRGBA"):
    """A colour, 0 to 1 each; an ``a`` of 0 is transparent. All are float32 in ROS."""

    r: float = 0.0
    g: float = 0.0
    b: float = 0.0
    a: float = 0.0


class Header(Message, type_name="std_msgs/msg/Header"):
    """When something was true, and in which frame of coordinates."""

    stamp: Time = Time()
    frame_id: str = ""
