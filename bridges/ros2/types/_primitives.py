"""ROS's primitive types, a row each; what depends on a primitive derives from its row.

Definitions are parsed (:mod:`.definition`), classes annotated (:mod:`.message_classes`), types
hashed (:mod:`.hashing`), codecs compiled (:mod:`.cdr`) and faults explained (:mod:`.diagnosis`) by
this table. A new number is a row and nothing else. A new kind of text also needs functions such as
those at the end, which compiled codecs call, and their call in :mod:`.cdr`.

In CDR a text is a uint32 length, the UTF-8 bytes and a NUL, which counts. A length of 0 is read as
an empty text, as eProsima's CDR does. A wide text is the number of its UTF-16 units and each unit
in four bytes, as in all middlewares of ROS 2.
"""

from __future__ import annotations

from collections.abc import Callable
from struct import Struct, pack, unpack, unpack_from
from typing import Any, NamedTuple

from llfsm.whiteboard.messages import types as ranges

_BOOLS = {"true": True, "1": True, "false": False, "0": False}
_ZEROS: dict[Any, bool | int | float | str] = {bool: False, float: 0.0, str: ""}
_ZERO_ONE = {False: 0, True: 1}.__getitem__  # any other value is a KeyError
_FALSE_TRUE = (False, True).__getitem__  # any other byte is an IndexError


class Primitive(NamedTuple):
    """A type that is built into ROS."""

    name: str
    code: str
    """Of the struct module; empty for texts."""
    size: int
    """Bytes, and so the alignment; of a text, those of the length before it."""
    type_id: int
    """Of one value in ROS's type descriptions, as hashed."""
    python: Any
    """The annotation in message classes."""
    bounded_id: int = 0
    """The type id of a text with a bound."""
    encoding: str = ""
    """Of a text, in Python's words."""
    write: Callable[[Any], int] | None = None
    """Turns a value into the byte on the wire, where struct would take wrong values."""
    read: Callable[[int], Any] | None = None
    """Turns the byte on the wire into the value."""

    @property
    def is_text(self) -> bool:
        """True for string and wstring."""
        return self.python is str

    @property
    def is_byte(self) -> bool:
        """True for whole numbers of which several are ``bytes`` in Python."""
        return self.python is ranges.UInt8

    @property
    def zero(self) -> bool | int | float | str:
        """The value of a field without a default."""
        return _ZEROS.get(self.python, 0)

    @property
    def range(self) -> tuple[int, int] | None:
        """The least and the greatest whole number; None for other types."""
        if self.python in _ZEROS:
            return None
        bits = 8 * self.size
        if self.code.isupper():
            return 0, 2**bits - 1
        return -(2 ** (bits - 1)), 2 ** (bits - 1) - 1

    def parse(self, text: str) -> bool | int | float | str:
        """Parse a value in a definition; raise a ValueError that names the type and its range."""
        if self.is_text:
            if len(text) > 1 and text[0] == text[-1] and text[0] in "\"'":
                text = text[1:-1].replace(f"\\{text[0]}", text[0])
            return text
        try:
            if self.python is bool:
                return _BOOLS[text.lower()]
            if self.python is float:
                return float(text)
            value = int(text, 0)
        except (KeyError, ValueError):
            raise ValueError(f"{text!r} is not of type {self.name}") from None
        if self.range is not None and not self.range[0] <= value <= self.range[1]:
            raise ValueError(f"{value} is not of type {self.name}{self.limits}")
        return value

    @property
    def limits(self) -> str:
        """The range as the end of an error's sentence; empty if there is none."""
        return "" if self.range is None else ", whose range is {} to {}".format(*self.range)


PRIMITIVES = {
    row.name: row
    for row in (
        # Read as a byte: struct takes any byte for a bool.
        Primitive("bool", "B", 1, 15, bool, write=_ZERO_ONE, read=_FALSE_TRUE),
        Primitive("byte", "B", 1, 16, ranges.UInt8),
        Primitive("char", "B", 1, 3, ranges.UInt8),  # in ROS 2 a char is a uint8, in hashes, too
        Primitive("int8", "b", 1, 2, ranges.Int8),
        Primitive("uint8", "B", 1, 3, ranges.UInt8),
        Primitive("int16", "h", 2, 4, ranges.Int16),
        Primitive("uint16", "H", 2, 5, ranges.UInt16),
        Primitive("int32", "i", 4, 6, ranges.Int32),
        Primitive("uint32", "I", 4, 7, ranges.UInt32),
        Primitive("int64", "q", 8, 8, ranges.Int64),
        Primitive("uint64", "Q", 8, 9, ranges.UInt64),
        Primitive("float32", "f", 4, 10, float),
        Primitive("float64", "d", 8, 11, float),
        Primitive("string", "", 4, 17, str, bounded_id=21, encoding="utf-8"),
        Primitive("wstring", "", 4, 18, str, bounded_id=22, encoding="utf-16-le"),
    )
}


# The rest is called by compiled codecs, which only detect a fault: diagnosis finds out what it is.


class UnreadableError(Exception):
    """The bytes do not decode."""


class UnwritableError(Exception):
    """The message cannot be encoded."""


def exact(value: bytes, size: int) -> bytes:
    """Check that a value has ``size`` bytes, and return it: struct would truncate or pad it."""
    if type(value) is not bytes or len(value) != size:
        raise UnwritableError
    return value


_LENGTHS = tuple(Struct(f"<{padding}xI").pack for padding in range(4))
_Unpack = Callable[[bytes, int], tuple[int]]


def read_texts(
    data: bytes, offset: int, count: int, bound: int, length: _Unpack
) -> tuple[tuple[str, ...], int]:
    """Read ``count`` texts; return them and the offset behind. ``length`` unpacks a uint32."""
    texts = []
    for _ in range(count):
        offset += -offset & 3
        (size,) = length(data, offset)
        start = offset + 4
        offset = start + size
        if data[offset - 1]:
            raise UnreadableError
        texts.append(data[start : offset - 1].decode())
    if bound and any(len(text) > bound for text in texts):
        raise UnreadableError
    return tuple(texts), offset


def write_texts(texts: tuple[str, ...], offset: int, bound: int) -> bytes:
    """Encode texts that start at an offset; each may have ``bound`` characters, 0: any number."""
    parts: list[bytes] = []
    for text in texts:
        if 0 < bound < len(text):
            raise UnwritableError
        raw = (text + "\0").encode()
        padding = -offset & 3
        parts += (_LENGTHS[padding](len(raw)), raw)
        offset += padding + 4 + len(raw)
    return b"".join(parts)


def narrow(data: bytes, offset: int, count: int, order: str) -> str:
    """Decode a wide text of ``count`` units."""
    units = unpack_from(f"{order}{count}I", data, offset)
    return pack(f"<{count}H", *units).decode("utf-16-le")


def widen(raw: bytes) -> bytes:
    """Encode a wide text, given as UTF-16, without its length."""
    count = len(raw) // 2
    return pack(f"<{count}I", *unpack(f"<{count}H", raw))


def read_wide_texts(
    data: bytes, offset: int, count: int, bound: int, order: str
) -> tuple[tuple[str, ...], int]:
    """Read ``count`` wide texts; return them and the offset behind."""
    texts = []
    offset += -offset & 3
    for _ in range(count):
        (units,) = unpack_from(f"{order}I", data, offset)
        texts.append(narrow(data, offset + 4, units, order))
        offset += 4 + 4 * units
    if bound and any(len(text) > bound for text in texts):
        raise UnreadableError
    return tuple(texts), offset


def write_wide_texts(texts: tuple[str, ...], offset: int, bound: int) -> bytes:
    """Encode wide texts that start at an offset."""
    parts = [bytes(-offset & 3)]
    for text in texts:
        if 0 < bound < len(text):
            raise UnwritableError
        raw = text.encode("utf-16-le")
        parts += (_LENGTHS[0](len(raw) // 2), widen(raw))
    return b"".join(parts)
