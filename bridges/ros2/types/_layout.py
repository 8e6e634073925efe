"""The layout of a message in CDR: its fields, their alignment, and formats for struct.

XCDR1, as ROS 2 uses it: a number of n bytes starts at a multiple of n, counted from the end of the
four bytes of header. Offsets here count from the start of the data, header included.

Numbers are aligned, not messages, and a text or a sequence may end anywhere. So how a message is
padded depends on where it starts, and behind a field of varying size all that can be known when a
codec is compiled is the remainder of the offset, modulo 1 (nothing), 2, 4 or 8 (all): :class:`At`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import gcd
from typing import Any, NamedTuple, get_args

import msgspec

from llfsm.bridges.ros2.types._primitives import PRIMITIVES
from llfsm.bridges.ros2.types.definition import Definition, FieldType, Shape
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
        """Combine a class with the definition of its fields, which ``find`` returns by name.

        Nested messages keep the classes that the class has for them.
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


HEADER = 4


class Item(NamedTuple):
    """One value in a struct's format."""

    code: str
    size: int
    align: int

    @classmethod
    def of(cls, base: str) -> Item:
        """Describe one number of a primitive type."""
        row = PRIMITIVES[base]
        return cls(row.code, row.size, row.size)


@dataclass(frozen=True)
class At:
    """An offset as far as it is known: its remainder, modulo 1 (nothing), 2, 4 or 8 (all)."""

    modulus: int = 1
    residue: int = 0

    def padding(self, align: int) -> int | None:
        """Count the bytes of padding before an alignment; None if they are not known."""
        return (HEADER - self.residue) % align if align <= self.modulus else None

    def after(self, size: int) -> At:
        """Move on by ``size`` bytes."""
        return At(self.modulus, (self.residue + size) % self.modulus)

    def either(self, other: At) -> At:
        """Keep of two possible offsets what they have in common."""
        modulus = gcd(self.modulus, other.modulus, self.residue - other.residue)
        return At(modulus, self.residue % modulus)


def padded(items: list[Item], offset: int) -> tuple[str, int]:
    """Make the format and its size of items that start at an offset; it has no byte order."""
    codes, start = "", offset
    for item in items:
        padding = (HEADER - offset) % item.align
        codes += f"{padding}x{item.code}" if padding else item.code
        offset += padding + item.size
    return codes, offset - start


def formats(items: list[Item], at: At) -> tuple[list[tuple[str, int]], At]:
    """Make the formats of items, with their sizes; return the offset behind them, too.

    It is a single format if the known remainder determines it, else eight: one for each remainder
    that the offset may have at run time.
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
    """List the items of a message that has one layout wherever it starts, so that many form a row.

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
