"""The capacity that a slot needs for a type."""

from __future__ import annotations

from msgspec import inspect as mi

from llfsm.whiteboard import Message
from llfsm.whiteboard.slots import DEFAULT_CAPACITY

__all__ = ["capacity_for"]

_UNBOUNDED = 64 * 1024
_NUMBER = 9  # bytes of the longest number in MessagePack
_HEADER = 5  # bytes before the longest text or array


def capacity_for(cls: type[Message]) -> int:
    """Return the bytes of a type's longest message; 64 KiB if its texts or arrays are unbounded."""
    longest = _longest(mi.type_info(cls))
    return _UNBOUNDED if longest is None else max(longest, DEFAULT_CAPACITY)


def _longest(node: mi.Type) -> int | None:
    match node:
        case mi.StructType():
            each = [_longest(field.type) for field in node.fields]
            return None if None in each else _HEADER + sum(filter(None, each))
        case mi.VarTupleType(max_length=int(most)):
            item = _longest(node.item_type)
            return None if item is None else _HEADER + most * item
        case mi.BytesType(max_length=int(most)):
            return _HEADER + most
        case mi.StrType(max_length=int(most)):
            return _HEADER + 4 * most  # of UTF-8
        case mi.BoolType() | mi.IntType() | mi.FloatType():
            return _NUMBER
        case _:
            return None
