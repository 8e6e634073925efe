"""States as whole numbers: each field has its bits, the small ones lowest.

Fields are packed tight, and those with few values come first, because the hash of a whole number
is the number: sets of them are fast only if the low bits differ.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import NamedTuple, TypeAlias

__all__ = ["Bits", "FieldName", "Packing"]

FieldName: TypeAlias = tuple[str, str]
"""What it is ("control", "variables", "elapsed", "slot", "seen", "stop"), and of what."""


class Bits(NamedTuple):
    """The bits of a field: `(state >> shift) & most` is its value."""

    shift: int
    most: int

    @property
    def mask(self) -> int:
        """The bits."""
        return self.most << self.shift

    def of(self, state: int) -> int:
        """Return the value in a state."""
        return (state >> self.shift) & self.most


class Packing:
    """Where each field is, given how many values each must have room for."""

    def __init__(self, sizes: Mapping[FieldName, int]):
        self.fields: dict[FieldName, Bits] = {}
        shift = 0
        for name, size in sorted(sizes.items(), key=lambda item: item[1]):
            width = max(size - 1, 0).bit_length()
            self.fields[name] = Bits(shift, (1 << width) - 1)
            shift += width
        self.all = (1 << shift) - 1
        """The bits of all fields."""

    def mask(self, names: Iterable[FieldName]) -> int:
        """Return the bits of the fields that there are."""
        fields = self.fields
        return sum(fields[name].mask for name in set(names) if name in fields)
