from __future__ import annotations

import dataclasses
import datetime
from types import new_class
from typing import Annotated, Any, Literal, NamedTuple, TypedDict, Union

import msgspec
import pytest

from llfsm.whiteboard import Message, MessageTypeError, Slot
from llfsm.whiteboard.messages.geometry_msgs import Twist, Vector3
from llfsm.whiteboard.schema import describe


@dataclasses.dataclass(frozen=True)
class Data:
    x: int = 0


class Named(NamedTuple):
    x: int = 0


class Typed(TypedDict):
    x: int


class Plain(msgspec.Struct):
    x: int = 0


class FrozenMap(msgspec.Struct, frozen=True):
    x: int = 0


class ChangingArray(msgspec.Struct, array_like=True):
    x: int = 0


def message(annotation: object, **config: Any) -> type[Message]:
    annotations = {"good": int, "bad": annotation}
    body = {"__annotations__": annotations, "__qualname__": "Made"}
    return new_class("Made", (Message,), config, lambda namespace: namespace.update(body))


MUTABLE: dict[str, tuple[Any, str]] = {
    "list": (list[int], r"tuple\[X, ...\]"),
    "bare list": (list, r"tuple\[X, ...\]"),
    "dict": (dict[str, int], "tuple of pairs"),
    "set": (set[int], "frozenset"),
    "bytearray": (bytearray, "use bytes"),
    "memoryview": (memoryview, "use bytes"),
    "Any": (Any, "name the types"),
    "dataclass": (Data, "Message instead of a dataclass"),
    "typed dict": (Typed, "use a Message"),
    "named tuple": (Named, "immutable"),
    "object": (object, "immutable|custom type"),
    "complex": (complex, "immutable|custom type"),
    "datetime": (datetime.datetime, "immutable"),
    "changing struct": (Plain, "Plain is not a Message, or not frozen"),
    "changing array": (ChangingArray, "ChangingArray is not a Message, or not frozen"),
    "frozen struct that is a map": (FrozenMap, "FrozenMap is not a Message"),
}


@pytest.mark.parametrize("kind", MUTABLE)
@pytest.mark.parametrize(
    ("wrap", "path"),
    [
        ("bad", "bad"),
        ("Union[bad, None]", "bad"),
        ("Union[bad, None, bool]", "bad"),
        ("tuple[bad, ...]", r"bad\[\]"),
        ("tuple[int, bad]", r"bad\[1\]"),
        ("tuple[tuple[int, Union[tuple[bad, ...], None]], ...]", r"bad\[\]\[1\]\[\]"),
        ("Annotated[bad, 'note']", "bad"),
    ],
)
def test_what_changes_is_refused_when_the_class_is_made(kind: str, wrap: str, path: str) -> None:
    bad, advice = MUTABLE[kind]
    with pytest.raises(MessageTypeError, match=rf"^Made\.{path}: .*({advice})"):
        message(eval(wrap, {"Union": Union, "Annotated": Annotated}, {"bad": bad}))


@pytest.mark.parametrize(
    "annotation",
    [
        *(bool, int, float, str, bytes, None, Literal["a", 2], tuple[()], tuple[int, ...]),
        *(frozenset[str], Vector3, tuple[Twist, ...] | None, Annotated[int, msgspec.Meta(ge=1)]),
    ],
    ids=str,
)
def test_what_cannot_change_is_taken(annotation: object) -> None:
    assert "bad" in describe(message(annotation))["properties"]


@pytest.mark.parametrize(
    "annotation",
    [str | bytes, Vector3 | Twist, tuple[int, ...] | Vector3, tuple[str | bytes, ...]],
    ids=str,
)
def test_a_union_that_is_ambiguous_to_a_decoder_is_refused(annotation: object) -> None:
    with pytest.raises(MessageTypeError, match=r"^Made\.bad: .*union"):
        message(annotation)


@pytest.mark.parametrize(
    ("config", "words"),
    [
        ({"frozen": False}, "Made is not a Message, or not frozen"),
        ({"array_like": False}, "Made is not a Message, or not frozen"),
        ({"tag": True}, "Made has a tag"),
        ({"tag": 3}, "Made has a tag"),
    ],
)
def test_a_configuration_that_breaks_the_promise_is_refused(
    config: dict[str, Any], words: str
) -> None:
    with pytest.raises(MessageTypeError, match=words):
        message(int, **config)


def test_a_message_does_not_change() -> None:
    twist = Twist()
    with pytest.raises(AttributeError):
        twist.linear = Vector3(1.0)
    with pytest.raises(AttributeError):
        twist.linear.x = 1.0
    assert twist == Twist()
    assert hash(twist) == hash(Twist())


def test_fields_are_inherited_in_order() -> None:
    class Stamped(Twist, type_name="test/Stamped"):
        stamp: int = 0

    assert list(describe(Stamped)["properties"]) == ["linear", "angular", "stamp"]
    assert msgspec.msgpack.decode(msgspec.msgpack.encode(Stamped(stamp=3)))[2] == 3


def test_a_subclass_cannot_add_what_changes() -> None:
    with pytest.raises(MessageTypeError, match=r"Bad\.items: a list is mutable"):

        class Bad(Twist):
            items: list[int] = []  # noqa: RUF012


def test_the_type_name_is_the_class_s_own() -> None:
    class Plain(Message):
        x: int = 0

    class Sub(Twist):
        pass

    assert describe(Twist)["title"] == "geometry_msgs/msg/Twist"
    assert describe(Plain)["title"] == "Plain"
    assert describe(Sub)["title"] == "Sub"
    assert describe(message(Twist))["properties"]["bad"]["title"] == "geometry_msgs/msg/Twist"


# ---- Names that come later: checked when a Slot asks -----------------------------------------


class Early(Message):
    later: Later


class EarlyBad(Message):
    deep: tuple[LaterBad, ...]


class Node(Message):
    value: int = 0
    following: Node | None = None


class Chicken(Message):
    egg: Egg | None = None


class Egg(Message):
    chicken: Chicken | None = None


class Later(Message):
    x: int = 0


LaterBad = list[int]


class Never(Message):
    x: NotAnywhere  # type: ignore[name-defined]  # noqa: F821


def test_a_name_that_came_later_is_found() -> None:
    assert Slot("a", Early).schema["properties"]["later"]["title"] == "Later"


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        (EarlyBad, r"^EarlyBad\.deep\[\]: a list is mutable"),
        (Node, r"^Node\.following: Node contains itself"),
        (Chicken, r"^Chicken\.egg\.chicken: Chicken contains itself"),
        (Egg, r"^Egg\.chicken\.egg: Egg contains itself"),
        (Never, "slot 'a': Never has an annotation that does not resolve: .*NotAnywhere"),
    ],
)
def test_a_name_that_came_later_is_checked_at_the_slot(kind: type[Message], words: str) -> None:
    with pytest.raises(MessageTypeError, match=words):
        Slot("a", kind)
