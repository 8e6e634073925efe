from __future__ import annotations

import pickle

import msgspec
import pytest

from llfsm.whiteboard import Message, MessageTypeError, Slot, SlotNameError
from llfsm.whiteboard.messages.geometry_msgs import Pose, Twist, Vector3
from llfsm.whiteboard.messages.turtlesim import Pose as TurtlePose
from llfsm.whiteboard.slots import DEFAULT_CAPACITY


@pytest.mark.parametrize("name", ["a", "turtle1/cmd_vel", "größe", "a" * 255, "é" * 127, "-./'"])
def test_a_possible_name(name: str) -> None:
    assert Slot(name, Twist).name == name


@pytest.mark.parametrize(
    "name",
    ["", " ", "a b", "a\n", "\ta", "a\0b", "\x7f", "a\u00a0b", "a" * 256, "é" * 128, "\ud800"],
    ids=ascii,
)
def test_an_impossible_name(name: str) -> None:
    with pytest.raises(SlotNameError, match="is not a valid slot name: use 1 to 255 bytes"):
        Slot(name, Twist)


@pytest.mark.parametrize("capacity", [1, DEFAULT_CAPACITY, 2**30])
def test_a_possible_capacity(capacity: int) -> None:
    assert Slot("a", Twist, capacity).capacity == capacity


@pytest.mark.parametrize("capacity", [0, -1, 2**30 + 1, 2**64])
def test_an_impossible_capacity(capacity: int) -> None:
    with pytest.raises(
        SlotNameError, match=rf"slot 'a': the capacity {capacity} is not an integer from 1 to"
    ):
        Slot("a", Twist, capacity)


@pytest.mark.parametrize(
    "kind", [int, dict, Twist(), "Twist", None, msgspec.defstruct("S", [], frozen=True)], ids=repr
)
def test_a_slot_takes_message_classes_only(kind: object) -> None:
    with pytest.raises(MessageTypeError, match=r"slot 'a': .* is not a Message class"):
        Slot("a", kind)  # type: ignore[arg-type]


def test_the_fingerprint_is_that_of_the_schema() -> None:
    class Twin(Message, type_name="geometry_msgs/msg/Twist"):
        linear: Vector3
        angular: Vector3

    assert Slot("a", Twin).schema == Slot("b", Twist).schema
    assert Slot("a", Twin).fingerprint == Slot("b", Twist, 64).fingerprint
    prints = {Slot("a", kind).fingerprint for kind in (Twist, Pose, TurtlePose)}
    assert len(prints) == 3
    assert all(0 <= print_ < 2**64 for print_ in prints)


def test_a_slot_survives_pickling() -> None:
    slot = pickle.loads(pickle.dumps(Slot("a", Twist, 99)))
    assert (slot.name, slot.type, slot.capacity) == ("a", Twist, 99)
    assert slot.fingerprint == Slot("a", Twist).fingerprint


def test_a_slot_shows_its_name_and_type() -> None:
    assert repr(Slot("turtle1/cmd_vel", Twist)) == "Slot('turtle1/cmd_vel', Twist)"
    assert Slot("a", Twist).type_name == "geometry_msgs/msg/Twist"
