"""The alignment of CDR: what is known of an offset at compile time, and formats for struct.

XCDR1, as ROS 2 uses it: a number of n bytes starts at a multiple of n, counted from the end of the
four bytes of header. Offsets here count from the start of the data, header included.

A definition together with its Message class, from which codecs are compiled.

Functions that compiled codecs call: rows of texts, and texts of wide characters.

A text is a uint32 length, the UTF-8 bytes and a NUL, which counts. A length of 0 is read as an
empty text, as eProsima's CDR does. A wide text is the number of its UTF-16 units and each unit in
four bytes, as in all middlewares of ROS 2.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import gcd
from struct import Struct, pack, unpack, unpack_from
from typing import Any, NamedTuple, get_args

import msgspec

from llfsm.bridges.ros2.types.definition import PRIMITIVES, Definition, FieldType, Shape
from llfsm.whiteboard import Message


@dataclass(frozen=True, eq=False)
class RecordField:
    """A field; ``record`` is the type of the messages in it, if any."""

    name: str  # in Python
    type: FieldType
    record: RecordType | None


@dataclass(frozen=True, eq=False)
class RecordType:
    """A message: its class and its fields."""

    name: str
    cls: type[Message]
    members: tuple[RecordField, ...]

    @classmethod
    def of(cls, name: str, message: type[Message], find: Callable[[str], Definition]) -> RecordType:
        """Combine a class with the definition of its fields; nested classes are the class's own.

        ``find`` returns the definition of a name.
        """
        held = msgspec.structs.fields(message)
        members = [
            RecordField(
                field.attribute,
                field.type,
                cls.of(field.type.base, _inmost(info.type), find) if field.type.nested else None,
            )
            for field, info in zip(find(name).fields, held, strict=True)
        ]
        return cls(name, message, tuple(members))


def _inmost(annotation: Any) -> Any:
    while arguments := get_args(annotation):  # of Annotated[tuple[X, ...], ...], X
        annotation = arguments[0]
    return annotation


class UnreadableError(Exception):
    """The bytes do not decode; :mod:`.diagnosis` finds out why."""


class UnwritableError(Exception):
    """The message cannot be encoded; :mod:`.diagnosis` finds out why."""


FALSE_TRUE = (False, True).__getitem__  # any other byte is an IndexError
ZERO_ONE = {False: 0, True: 1}.__getitem__  # any other value is a KeyError


def exact(value: bytes, size: int) -> bytes:
    """Return the value if it has that size: struct would truncate or pad it."""
    if type(value) is not bytes or len(value) != size:
        raise UnwritableError
    return value


_LENGTHS = tuple(Struct(f"<{padding}xI").pack for padding in range(4))
_Unpack = Callable[[bytes, int], tuple[int]]


def read_texts(
    data: bytes, offset: int, count: int, bound: int, length: _Unpack
) -> tuple[tuple[str, ...], int]:
    """Return ``count`` texts and the offset after them; ``length`` unpacks a uint32."""
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
    """Return the bytes of texts that start at an offset."""
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
    """Return the wide text of ``count`` units."""
    units = unpack_from(f"{order}{count}I", data, offset)
    return pack(f"<{count}H", *units).decode("utf-16-le")


def widen(raw: bytes) -> bytes:
    """Return the bytes of a wide text from its UTF-16."""
    count = len(raw) // 2
    return pack(f"<{count}I", *unpack(f"<{count}H", raw))


def read_wide_texts(
    data: bytes, offset: int, count: int, bound: int, order: str
) -> tuple[tuple[str, ...], int]:
    """Return ``count`` wide texts and the offset after them."""
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
    """Return the bytes of wide texts that start at an offset."""
    parts = [bytes(-offset & 3)]
    for text in texts:
        if 0 < bound < len(text):
            raise UnwritableError
        raw = text.encode("utf-16-le")
        parts += (_LENGTHS[0](len(raw) // 2), widen(raw))
    return b"".join(parts)


HEADER = 4


class Item(NamedTuple):
    """One value in a struct's format."""

    code: str
    size: int
    align: int

    @classmethod
    def of(cls, primitive: str) -> Item:
        """Return the item of a primitive number."""
        code, size, _ = PRIMITIVES[primitive]
        return cls(code, size, size)


@dataclass(frozen=True)
class At:
    """What is known of an offset: its remainder, modulo 1 (nothing), 2, 4 or 8 (all)."""

    modulus: int = 1
    residue: int = 0

    def padding(self, align: int) -> int | None:
        """Return the bytes of padding before an alignment; None if that is not known."""
        return (HEADER - self.residue) % align if align <= self.modulus else None

    def after(self, size: int) -> At:
        """Return what is known ``size`` bytes later."""
        return At(self.modulus, (self.residue + size) % self.modulus)

    def either(self, other: At) -> At:
        """Return what is known if the offset is one or the other."""
        modulus = gcd(self.modulus, other.modulus, self.residue - other.residue)
        return At(modulus, self.residue % modulus)


def padded(items: list[Item], offset: int) -> tuple[str, int]:
    """Return the format of items that start at an offset, without byte order, and its size."""
    codes, start = "", offset
    for item in items:
        padding = (HEADER - offset) % item.align
        codes += f"{padding}x{item.code}" if padding else item.code
        offset += padding + item.size
    return codes, offset - start


def formats(items: list[Item], at: At) -> tuple[list[tuple[str, int]], At]:
    """Return the formats of items by their offset's remainder, and what is known of their end.

    It is a single format if what is known of the offset determines it, else eight.
    """
    align = max(item.align for item in items)
    if align <= at.modulus:
        only = padded(items, at.residue)
        return [only], at.after(only[1])
    found = [padded(items, offset) for offset in range(8)]
    end = At(8, found[0][1] % 8)
    for offset, (_, size) in enumerate(found):
        end = end.either(At(8, (offset + size) % 8))
    return found, end


def fixed_items(record: RecordType) -> list[Item] | None:
    """Return the items of a message with one layout wherever it starts, so that many form a row.

    None if it has fields of varying size or arrays of numbers, if its first item needs less
    alignment than another (CDR aligns numbers, not messages: then the padding inside depends on
    where it starts), or if padding would be needed between two messages.
    """
    items = _items(record)
    if items is None:
        return None
    align = max(item.align for item in items)
    size = padded(items, HEADER)[1]
    return items if items[0].align == align and size % align == 0 else None


def _items(record: RecordType) -> list[Item] | None:
    items: list[Item] = []
    for member in record.members:
        kind = member.type
        if kind.shape is Shape.ARRAY and kind.is_bytes:
            items.append(Item(f"{kind.size}s", kind.size, 1))
        elif kind.shape is not Shape.SINGLE or kind.is_text:
            return None
        elif member.record is None:
            items.append(Item.of(kind.base))
        else:
            inner = _items(member.record)
            if inner is None:
                return None
            items += inner
    return items or [Item("x", 1, 1)]
