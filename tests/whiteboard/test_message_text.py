"""Messages and message types as users write them."""

from __future__ import annotations

import pytest

from llfsm.whiteboard import Message, MessageFieldError, MessageTypeError, Slot
from llfsm.whiteboard.message_text import message_class, parse_message, shipped_types
from llfsm.whiteboard.messages.geometry_msgs import Twist, Vector3
from llfsm.whiteboard.messages.turtlesim import Pose


class Mixed(Message, type_name="test/Mixed"):
    data: bytes
    numbers: tuple[int, ...]
    at: Vector3 | None
    name: str


TWIST: Slot[Message] = Slot("cmd_vel", Twist)
MIXED: Slot[Message] = Slot("mixed", Mixed)


@pytest.mark.parametrize("text", ['{"linear": {"x": 1}}', b'{"linear": {"x": 1}}'])
def test_omitted_fields_are_zero(text: str | bytes) -> None:
    assert parse_message(TWIST, text) == Twist(linear=Vector3(x=1.0))
    assert parse_message(TWIST, "{}") == Twist()
    assert parse_message(MIXED, "{}") == Mixed(b"", (), None, "")


def test_every_kind_of_field_has_a_text() -> None:
    text = '{"data": "AQI=", "numbers": [1, 2], "at": {"y": 2.5}, "name": "a"}'
    assert parse_message(MIXED, text) == Mixed(b"\x01\x02", (1, 2), Vector3(y=2.5), "a")


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("{", "Expecting property name"),
        ("", "Expecting value"),
        ("[1]", 'not a JSON object such as {"linear": ...}'),
        ("1", 'not a JSON object such as {"linear": ...}'),
        ('{"lineer": {}}', "no field 'lineer'; it has linear, angular"),
        ('{"linear": {"x": "fast"}}', "Expected `float`, got `str` - at `linear.x`"),
        ('{"linear": null}', "Expected `array`, got `null` - at `linear`"),
    ],
)
def test_a_text_that_is_not_such_a_message_is_refused_with_the_reason(text: str, why: str) -> None:
    with pytest.raises(MessageFieldError) as raised:
        parse_message(TWIST, text)
    assert str(raised.value).startswith("slot 'cmd_vel': invalid message: ")
    assert why in str(raised.value)


@pytest.mark.parametrize(
    ("name", "found"),
    [
        ("geometry_msgs/Twist", Twist),
        ("geometry_msgs/msg/Twist", Twist),
        ("turtlesim/Pose", Pose),
        ("llfsm.whiteboard.messages.turtlesim:Pose", Pose),
    ],
)
def test_a_type_is_found_by_its_ros_name_or_its_place(name: str, found: type[Message]) -> None:
    assert message_class(name) is found


@pytest.mark.parametrize(
    "name",
    [
        "", "/", ":", "Twist", "geometry_msgs/Twisted", "no_msgs/Twist", "../geometry_msgs/Twist",
        "no.such.module:Twist", "llfsm.whiteboard:Missing", ".relative:Twist", "a b/c",
        "geometry_msgs/Annotated", "llfsm/Bell",
    ],
)  # fmt: skip
def test_an_unknown_type_is_refused(name: str) -> None:
    with pytest.raises(MessageTypeError, match="no message type"):
        message_class(name)


@pytest.mark.parametrize("name", ["json:JSONDecoder", "json:loads"])
def test_another_object_is_not_a_type(name: str) -> None:
    with pytest.raises(MessageTypeError, match="is not a Message class"):
        message_class(name)


def test_what_ships_is_of_ros_and_not_what_processes_of_llfsm_tell_each_other() -> None:
    assert {Twist, Pose} <= set(shipped_types())
    packages = sorted({each.__module__.rpartition(".")[2] for each in shipped_types()})
    assert packages == [
        "builtin_interfaces", "geometry_msgs", "sensor_msgs", "std_msgs", "turtle_sensor_poster",
        "turtlesim",
    ]  # fmt: skip
    with pytest.raises(MessageTypeError, match=rf"packages are {', '.join(packages)}$"):
        message_class("nopack/Foo")
    with pytest.raises(MessageTypeError, match="geometry_msgs has no 'Twisted'; did you mean"):
        message_class("geometry_msgs/Twisted")
