"""The alignment of CDR: what is known of an offset at compile time, and formats for struct.

XCDR1, as ROS 2 uses it: a number of n bytes starts at a multiple of n, counted from the end of the
four bytes of header. Offsets here count from the start of the data, header included.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import gcd
from typing import NamedTuple

from .definition import PRIMITIVES, Shape
from .record_type import RecordType

__all__ = ["HEADER", "At", "Item", "fixed_items", "formats", "padded"]

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
