"""Services and actions in slots: their messages with a number, and the slots' capacities.

A caller posts a request with a number above all earlier ones, and pulls until there is an answer
with that number; an answer may be a failure. A slot holds one message, so independent callers need
slots of their own. An action has one goal at a time: the machine's own, or one that it serves.

| slot | a client's | a server's |
|---|---|---|
| ``goal`` | machine to bridge: send it | bridge to machine: asked to do it |
| ``cancel`` | machine to bridge | bridge to machine |
| ``status`` | bridge to machine: each change | machine to bridge: accepted, or refused |
| ``feedback`` | bridge to machine | machine to bridge |
| ``result`` | bridge to machine, before the final status | machine to bridge: ends the goal |

A slot's capacity is fixed when it is made, but most ROS types have no longest message. Then it is
what sensors of the type usually need, and the plan warns where messages are likely to be lost.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from msgspec import inspect as mi
from msgspec.structs import astuple, fields

from llfsm.bridges.ros2.types import RosAction, RosMessage, RosService
from llfsm.bridges.ros2.types.message_classes import new_message
from llfsm.runtime.goals import CancelGoal, GoalStanding, GoalStatus
from llfsm.whiteboard import Message, Slot
from llfsm.whiteboard.slots import DEFAULT_CAPACITY

_UNBOUNDED = 64 * 1024
_NUMBER = 9  # bytes of the longest number in MessagePack
_HEADER = 5  # bytes before the longest text or array
_REST = 4096  # bytes for what a sensor's message has beside its data


class _Usual(NamedTuple):
    """The usual messages of sensors, of a type without a longest message."""

    least: int
    """Bytes of a small message: with a smaller slot, expect to lose all of them."""
    default: int
    """Bytes that a new slot gets."""
    example: str
    """Messages that fit in the default."""


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
    """Choose the capacity of a new slot: the bytes of the type's longest message.

    If its texts or arrays are unbounded, it is what sensors of that type usually need, or 64 KiB.
    """
    usual = _usual(cls)
    if usual is not None:
        return usual.default
    longest = _longest(mi.type_info(cls))
    return _UNBOUNDED if longest is None else max(longest, DEFAULT_CAPACITY)


def capacity_note(slot: Slot[Message]) -> str | None:
    """Describe the default capacity of a sensor type's slot; None for other capacities."""
    usual = _usual(slot.type)
    if usual is None or slot.capacity != usual.default:
        return None
    return f"slot {slot.name!r} takes up to {slot.capacity:,} bytes, enough for {usual.example}"


def capacity_warning(slot: Slot[Message], capacity: int, *, chosen: bool) -> str | None:
    """Explain why messages of a slot with this capacity would be lost; None if they would not.

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
    """Check if a type has bytes or numbers without a bound: data, not names."""
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


class ServiceSlots(NamedTuple):
    """The two slots of a service.

    Attributes:
        request: its messages have ``number`` and the fields of the service's request.
        answer: its messages have ``number``, the fields of the response, and ``failure``, which
            is the reason why there is no response, or empty.

    """

    request: Slot[Any]
    answer: Slot[Any]
    of: RosService

    def failed(self, number: int, why: str) -> Message:
        """Make the answer that reports a failure."""
        return self.answer.type(number=number, failure=why)  # type: ignore[no-any-return]


def into_slot(slot: Slot[Any], number: int, message: Message, *last: Any) -> Message:
    """Number a message of ROS for a slot; ``last`` are values of the slot's own behind it."""
    return slot.type(number, *astuple(message), *last)  # type: ignore[no-any-return]


def from_slot(of: RosMessage[Any], message: Message) -> Any:
    """Take the message of ROS out of one in a slot."""
    return of.message(*astuple(message)[1 : 1 + len(of.message.__struct_fields__)])


def service_slots(name: str, of: RosService, capacity: int | None = None) -> ServiceSlots:
    """Make the slots ``name/request`` and ``name/answer`` of a service type.

    A field of the service with the name of one of ours gets an underscore. Raise
    :class:`.SlotNameError`.
    """
    asked, answered = numbered(of.request), numbered(of.response, failure="")
    return ServiceSlots(
        Slot(f"{name}/request", asked, capacity or capacity_for(asked)),
        Slot(f"{name}/answer", answered, capacity or capacity_for(answered)),
        of,
    )


def numbered(of: RosMessage[Any], **last: Any) -> type[Message]:
    """Make a class with a number, the fields of a type, and ``last`` with their defaults.

    A field of the type with a name of ours gets an underscore.
    """
    annotations: dict[str, Any] = {"number": int}
    values: dict[str, Any] = {"number": 0}
    for field in fields(of.message):
        name = f"{field.name}_" if field.name in {"number", "failure", *last} else field.name
        annotations[name] = field.type
        values[name] = field.default
    annotations |= {field: type(value) for field, value in last.items()}
    return new_message(of.name, annotations, {"__doc__": f"{of.name} in a slot."} | values | last)


class ActionSlots(NamedTuple):
    """The five slots of an action.

    Attributes:
        goal: its messages have ``number`` and the fields of the action's goal.
        cancel: :class:`.CancelGoal`.
        status: :class:`.GoalStanding`.
        feedback: ``number`` and the fields of the feedback.
        result: ``number``, the fields of the result, ``status``, and ``failure``, the reason if
            the server did not end it, or empty.

    """

    goal: Slot[Any]
    cancel: Slot[CancelGoal]
    status: Slot[GoalStanding]
    feedback: Slot[Any]
    result: Slot[Any]
    of: RosAction

    def failed(self, number: int, status: GoalStatus, why: str) -> Message:
        """Make the result of a goal that its server did not end."""
        return self.result.type(number=number, status=status, failure=why)  # type: ignore[no-any-return]


def action_slots(name: str, of: RosAction, capacity: int | None = None) -> ActionSlots:
    """Make the slots ``name/goal``, ``name/cancel`` and so on of an action type.

    A field of the action with the name of one of ours gets an underscore. Raise
    :class:`.SlotNameError`.
    """

    def slot(what: str, cls: type[Any]) -> Slot[Any]:
        return Slot(f"{name}/{what}", cls, capacity or capacity_for(cls))

    return ActionSlots(
        slot("goal", numbered(of.goal)),
        Slot(f"{name}/cancel", CancelGoal),
        Slot(f"{name}/status", GoalStanding),
        slot("feedback", numbered(of.feedback)),
        slot("result", numbered(of.result, status=GoalStatus.UNKNOWN, failure="")),
        of,
    )
