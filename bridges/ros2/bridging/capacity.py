"""The capacity that a slot needs for a type, and what is lost with a smaller one."""

from __future__ import annotations

from typing import NamedTuple

from msgspec import inspect as mi

from llfsm.whiteboard import Message, Slot
from llfsm.whiteboard.slots import DEFAULT_CAPACITY

__all__ = ["capacity_for", "capacity_note", "capacity_warning"]

_UNBOUNDED = 64 * 1024
_NUMBER = 9  # bytes of the longest number in MessagePack
_HEADER = 5  # bytes before the longest text or array
_REST = 4096  # bytes for what a sensor's message has beside its data


class _Usual(NamedTuple):
    """What sensors of a type without a longest message usually send."""

    least: int
    """Bytes of a small message: with a smaller slot, expect to lose all of them."""
    default: int
    """Bytes that a new slot gets."""
    example: str
    """What fits in the default."""


_USUAL = {
    f"sensor_msgs/msg/{name}": usual
    for name, usual in {
        "Image": _Usual(640 * 480, 1280 * 720 * 3 + _REST, "1280x720 pixels of 3 bytes"),
        "CompressedImage": _Usual(_UNBOUNDED, 1 << 20, "a JPEG of 1 MiB"),
        "PointCloud2": _Usual(16 * 1800 * 16, 64 * 1024 * 48 + _REST, "65,536 points of 48 bytes"),
        "PointCloud": _Usual(_UNBOUNDED, 1 << 20, "30,000 points"),
        "LaserScan": _Usual(360 * _NUMBER, _UNBOUNDED, "3,600 beams with intensities"),
        "MultiEchoLaserScan": _Usual(_UNBOUNDED // 4, 1 << 18, "1,000 beams of 10 echoes"),
        "JointState": _Usual(6 * 4 * _NUMBER, _UNBOUNDED, "1,000 joints"),
        "MultiDOFJointState": _Usual(DEFAULT_CAPACITY, _UNBOUNDED, "200 joints"),
        "Joy": _Usual(20 * _NUMBER, _UNBOUNDED, "7,000 axes and buttons"),
    }.items()
}
_USUAL["geometry_msgs/msg/TransformStamped"] = _Usual(
    256, DEFAULT_CAPACITY, "frames with names of 400 letters"
)


def capacity_for(cls: type[Message]) -> int:
    """Return the bytes of a type's longest message.

    If its texts or arrays are unbounded, it is what sensors of that type usually need, or 64 KiB.
    """
    usual = _usual(cls)
    if usual is not None:
        return usual.default
    longest = _longest(mi.type_info(cls))
    return _UNBOUNDED if longest is None else max(longest, DEFAULT_CAPACITY)


def capacity_note(slot: Slot[Message]) -> str | None:
    """Return what fits in a new slot whose capacity is a sensor type's default, or None."""
    usual = _usual(slot.type)
    if usual is None or slot.capacity != usual.default:
        return None
    return f"slot {slot.name!r} takes up to {slot.capacity:,} bytes, enough for {usual.example}"


def capacity_warning(slot: Slot[Message], capacity: int, *, chosen: bool) -> str | None:
    """Return why messages of a slot with this capacity would be lost, or None.

    ``chosen``: the configuration or the board names the capacity, it is not the default.
    """
    usual = _usual(slot.type)
    if usual is not None and capacity < usual.least:
        return (
            f"slot {slot.name!r} takes {capacity:,} bytes; messages of {slot.type_name} usually "
            f"need {usual.least:,} or more, and longer ones are lost: set a larger `capacity`"
        )
    if usual is None and not chosen and _has_bulk(mi.type_info(slot.type)):
        return (
            f"{slot.type_name} has no maximum size; slot {slot.name!r} takes {capacity:,} "
            "bytes, and longer ones are lost: set the `capacity` that you need"
        )
    return None


def _usual(cls: type[Message]) -> _Usual | None:
    name: str = cls.__type_name__  # type: ignore[attr-defined]
    return _USUAL.get(name)


def _has_bulk(node: mi.Type) -> bool:
    """Return whether a type has bytes or numbers without a bound: data, not names."""
    match node:
        case mi.StructType():
            return any(_has_bulk(field.type) for field in node.fields)
        case mi.VarTupleType():
            numbers = isinstance(node.item_type, mi.IntType | mi.FloatType)
            return _has_bulk(node.item_type) or (numbers and node.max_length is None)
        case mi.BytesType():
            return node.max_length is None
        case _:
            return False


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
