from __future__ import annotations

import enum
import json
from types import new_class
from typing import Annotated, Any, Literal

import msgspec
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from llfsm.whiteboard import Message, MessageTypeError, Slot
from llfsm.whiteboard.message import type_from_schema
from llfsm.whiteboard.messages.geometry_msgs import Pose, Twist, Vector3
from llfsm.whiteboard.schema import (
    describe,
    differences,
    fingerprint,
    from_plain,
    to_plain,
)
from thoroughness import examples


class Colour(enum.Enum):
    RED = "red"
    BLUE = "blue"


class Level(enum.IntEnum):
    HIGH = 7
    LOW = -1


# ---- Any type, and a value of it ------------------------------------------------------------

Typed = tuple[Any, st.SearchStrategy[Any]]

HASHABLE: list[Typed] = [
    (bool, st.booleans()),
    (int, st.integers(-(2**63), 2**64 - 1)),
    (str, st.text(max_size=6)),
    (Colour, st.sampled_from(Colour)),
    (Level, st.sampled_from(Level)),
    (Literal["b", "a"], st.sampled_from(["a", "b"])),
    (Annotated[int, msgspec.Meta(ge=-5, le=7)], st.integers(-5, 7)),
    (Annotated[str, msgspec.Meta(max_length=3)], st.text(max_size=3)),
]
LEAVES: list[Typed] = [
    *HASHABLE,
    (float, st.floats(allow_nan=False)),
    (Annotated[float, msgspec.Meta(ge=0.5)], st.floats(0.5, 9)),
    (bytes, st.binary(max_size=6)),
    (Annotated[bytes, msgspec.Meta(max_length=4)], st.binary(max_size=4)),
    (Literal[None], st.none()),
    (Vector3, st.builds(Vector3, x=st.floats(allow_nan=False))),
]


def made(fields: list[Typed], name: str = "Made") -> Typed:
    annotations = {f"f{i}": annotation for i, (annotation, _) in enumerate(fields)}
    body = {"__annotations__": annotations}
    cls = new_class(name, (Message,), {"type_name": f"t/{name}"}, lambda space: space.update(body))
    return cls, st.builds(cls, *(values for _, values in fields))


def containers(inner: st.SearchStrategy[Typed]) -> st.SearchStrategy[Typed]:
    def many(item: Typed, least: int) -> Typed:
        some = Annotated[tuple[item[0], ...], msgspec.Meta(min_length=least, max_length=4)]
        return some, st.lists(item[1], min_size=least, max_size=4).map(tuple)

    return st.one_of(
        inner.map(lambda t: (tuple[t[0], ...], st.lists(t[1], max_size=3).map(tuple))),
        st.builds(many, inner, st.integers(0, 2)),
        st.builds(lambda a, b: (tuple[a[0], b[0]], st.tuples(a[1], b[1])), inner, inner),
        inner.map(lambda t: (t[0] | None, st.none() | t[1])),
        st.lists(inner, max_size=3).map(lambda fields: made(fields, "Nested")),
        st.sampled_from(HASHABLE).map(
            lambda t: (
                Annotated[frozenset[t[0]], msgspec.Meta(max_length=3)],
                st.frozensets(t[1], max_size=3),
            )
        ),
    )


TYPES = st.lists(
    st.recursive(st.sampled_from(LEAVES), containers, max_leaves=6), min_size=1, max_size=4
).map(made)

any_type = settings(
    deadline=None, max_examples=examples(40), suppress_health_check=[HealthCheck.too_slow]
)


@any_type
@given(TYPES)
def test_a_class_made_from_a_schema_has_that_schema(typed: Typed) -> None:
    schema = describe(typed[0])
    through_json = msgspec.json.decode(msgspec.json.encode(schema))
    assert through_json == schema
    assert describe(type_from_schema(through_json)) == schema
    assert fingerprint(through_json) == Slot("a", typed[0]).fingerprint


@any_type
@given(TYPES, st.data())
def test_a_message_survives_json(typed: Typed, data: st.DataObject) -> None:
    cls, messages = typed
    message, schema = data.draw(messages), describe(cls)
    plain = json.loads(json.dumps(to_plain(message)))
    assert list(plain) == list(cls.__struct_fields__)
    arrays = from_plain(plain, schema)
    encoded = msgspec.msgpack.encode(arrays)
    assert msgspec.msgpack.decode(encoded, type=cls) == message
    assert msgspec.convert(arrays, cls) == message
    # and by the class that a tool makes of the schema
    seen = to_plain(msgspec.msgpack.decode(encoded, type=type_from_schema(schema)))
    assert msgspec.convert(from_plain(json.loads(json.dumps(seen)), schema), cls) == message


@any_type
@given(TYPES)
def test_what_is_left_out_is_zero(typed: Typed) -> None:
    cls, _ = typed
    message = msgspec.convert(from_plain({}, describe(cls)), cls)
    assert isinstance(message, cls)
    again = from_plain(json.loads(json.dumps(to_plain(message))), describe(cls))
    assert msgspec.convert(again, cls) == message


@any_type
@given(TYPES, TYPES)
def test_schemas_differ_exactly_if_there_are_differences(one: Typed, other: Typed) -> None:
    a, b = describe(one[0]), describe(other[0])
    assert list(differences(a, a)) == []
    assert bool(list(differences(a, b))) == (a != b)
    assert (fingerprint(a) == fingerprint(b)) == (a == b)


# ---- Known answers --------------------------------------------------------------------------


def test_the_schema_is_json_schema() -> None:
    class Known(Message, type_name="test/Known"):
        small: Annotated[int, msgspec.Meta(ge=0, le=255)]
        data: bytes
        colour: Colour
        maybe: float | None
        points: tuple[Vector3, ...]
        pair: tuple[bool, str]
        names: frozenset[str]

    number = {"type": "number"}
    assert describe(Known) == {
        "title": "test/Known",
        "type": "object",
        "properties": {
            "small": {"type": "integer", "minimum": 0, "maximum": 255},
            "data": {"type": "string", "contentEncoding": "base64"},
            "colour": {"enum": ["blue", "red"]},
            "maybe": {"anyOf": [number, {"type": "null"}]},
            "points": {
                "type": "array",
                "items": {
                    "title": "geometry_msgs/msg/Vector3",
                    "type": "object",
                    "properties": {"x": number, "y": number, "z": number},
                    "required": ["x", "y", "z"],
                },
            },
            "pair": {
                "type": "array",
                "prefixItems": [{"type": "boolean"}, {"type": "string"}],
                "items": False,
            },
            "names": {"type": "array", "items": {"type": "string"}, "uniqueItems": True},
        },
        "required": ["small", "data", "colour", "maybe", "points", "pair", "names"],
    }


def test_a_message_in_plain_terms() -> None:
    class Photo(Message):
        data: bytes = b""
        at: Vector3 | None = None
        colours: tuple[Colour, ...] = ()

    photo = Photo(b"\xff\x00", Vector3(1.0), (Colour.RED,))
    plain = {"data": "/wA=", "at": {"x": 1.0, "y": 0.0, "z": 0.0}, "colours": ["red"]}
    assert to_plain(photo) == plain
    assert from_plain(plain, describe(Photo)) == [b"\xff\x00", [1.0, 0.0, 0.0], ["red"]]
    assert from_plain({"at": {"y": 2}}, describe(Photo)) == [b"", [0, 2, 0], []]
    assert from_plain({}, describe(Twist)) == [[0, 0, 0], [0, 0, 0]]


def test_zero_keeps_to_the_limits() -> None:
    class Limited(Message):
        high: Annotated[int, msgspec.Meta(ge=3)]
        low: Annotated[float, msgspec.Meta(le=-2.5)]
        level: Level
        two: Annotated[tuple[Level, ...], msgspec.Meta(min_length=2)]
        uuid: Annotated[bytes, msgspec.Meta(min_length=4, max_length=4)]

    assert from_plain({}, describe(Limited)) == [3, -2.5, -1, [-1, -1], bytes(4)]


@pytest.mark.parametrize(
    ("plain", "words"),
    [
        ({"x": 1}, r"geometry_msgs/msg/Twist has no field 'x'; it has linear, angular"),
        ({"linear": {"w": 1}}, r"geometry_msgs/msg/Vector3 has no field 'w'; it has x, y, z"),
    ],
)
def test_an_unknown_field_is_named(plain: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        from_plain(plain, describe(Twist))


@pytest.mark.parametrize("text", ["?", "YQ", "YQ=", "Y Q=", "é"])
def test_what_is_not_base64_is_refused(text: str) -> None:
    cls, _ = made([(bytes, st.binary())])
    with pytest.raises(ValueError, match=r"base64|padding|ASCII|Base64"):
        from_plain({"f0": text}, describe(cls))


@pytest.mark.parametrize("schema", [{"type": "anything"}, {}, {"$ref": "#/a"}])
def test_a_schema_that_is_none_of_ours_is_refused(schema: dict[str, Any]) -> None:
    with pytest.raises(MessageTypeError, match="not a message's schema"):
        type_from_schema({"title": "T", "type": "object", "properties": {"f": schema}})


class Theirs(Message, type_name="test/Same"):
    kept: int
    gone: str
    changed: float
    deep: Pose
    limited: Annotated[int, msgspec.Meta(ge=0)]


class Point(Message, type_name="geometry_msgs/msg/Point"):
    x: float
    y: int


class Pose2(Message, type_name="geometry_msgs/msg/Pose"):
    position: Point
    orientation: Vector3


class Ours(Message, type_name="test/Same"):
    kept: int
    changed: bytes
    deep: Pose2
    limited: int
    new: bool


def test_differences_are_listed_field_by_field() -> None:
    assert list(differences(describe(Theirs), describe(Ours))) == [
        "only the board has gone (type:string)",
        "changed is type:number on the board, type:string,contentEncoding:base64 in ours",
        "deep.position.y is type:number on the board, type:integer in ours",
        "only the board has deep.position.z (type:number)",
        "only the board has deep.orientation.w (type:number)",
        "deep.orientation is geometry_msgs/msg/Quaternion on the board, "
        "geometry_msgs/msg/Vector3 in ours",
        "limited is type:integer,minimum:0 on the board, type:integer in ours",
        "only ours has new (type:boolean)",
    ]


def test_another_order_of_fields_is_a_difference() -> None:
    class Swapped(Message, type_name="geometry_msgs/msg/Twist"):
        angular: Vector3
        linear: Vector3

    assert list(differences(describe(Twist), describe(Swapped))) == [
        "the fields: the board's order is linear, angular"
    ]


def test_every_limit_is_in_the_schema_and_comes_back() -> None:
    class Limited(Message):
        above: Annotated[float, msgspec.Meta(gt=0, lt=1)] = 0.5
        step: Annotated[int, msgspec.Meta(multiple_of=5)] = 0
        code: Annotated[str, msgspec.Meta(min_length=1, max_length=3, pattern="^[a-z]*$")] = "a"
        few: Annotated[tuple[int, ...], msgspec.Meta(min_length=1, max_length=2)] = (1,)

    schema = describe(Limited)
    assert schema["properties"] == {
        "above": {"type": "number", "exclusiveMinimum": 0, "exclusiveMaximum": 1},
        "step": {"type": "integer", "multipleOf": 5},
        "code": {"type": "string", "minLength": 1, "maxLength": 3, "pattern": "^[a-z]*$"},
        "few": {"type": "array", "items": {"type": "integer"}, "minItems": 1, "maxItems": 2},
    }
    assert describe(type_from_schema(schema)) == schema


@pytest.mark.parametrize("name", ["a\nb", "a\0b", "\ud800", "x" * 256])
def test_a_type_name_must_be_printable_and_short(name: str) -> None:
    with pytest.raises(MessageTypeError, match="is not a valid type name"):

        class Named(Message, type_name=name):
            pass


@pytest.mark.parametrize("schema", [{}, {"title": "T"}, {"title": "T", "properties": 3}])
def test_what_is_no_schema_of_a_message_is_refused(schema: dict[str, object]) -> None:
    with pytest.raises(MessageTypeError, match="not a message's schema"):
        type_from_schema(schema)
