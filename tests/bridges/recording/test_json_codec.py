"""A message as JSON is what the schema says, and becomes the same message again."""

from __future__ import annotations

import json
import math
from enum import Enum
from typing import Any, Literal

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from llfsm.bridges.recording.writer import EXACT, JsonCodec
from llfsm.whiteboard import Message, Slot
from llfsm.whiteboard.messages.geometry_msgs import Twist, Vector3


class Colour(Enum):
    RED = "red"
    BLUE = "blue"


class Inner(Message):
    real: float = 0.0
    name: str = ""


class All(Message):
    truth: bool
    whole: int
    real: float
    text: str
    data: bytes
    colour: Colour
    mode: Literal["a", "b", 3]
    inner: Inner
    either: int | float | str | None
    perhaps: Inner | None
    pair: tuple[int, bytes]
    many: tuple[Inner, ...]
    set_: frozenset[int]
    reals: tuple[float | None, ...]


wholes = st.integers(-(2**63), 2**63 - 1)
texts = st.text(st.characters(exclude_categories=["Cs"]))
inners = st.builds(Inner, real=st.floats(), name=texts)
messages = st.builds(
    All,
    truth=st.booleans(),
    whole=wholes,
    real=st.floats(),
    text=texts,
    data=st.binary(),
    colour=st.sampled_from(Colour),
    mode=st.sampled_from(["a", "b", 3]),
    inner=inners,
    either=st.one_of(wholes, st.floats(), texts, st.none()),
    perhaps=st.one_of(inners, st.none()),
    pair=st.tuples(wholes, st.binary()),
    many=st.lists(inners, max_size=3).map(tuple),
    set_=st.frozensets(wholes, max_size=3),
    reals=st.lists(st.floats() | st.none(), max_size=3).map(tuple),
)


def bits(value: Any) -> Any:
    """Return what is equal exactly for values that are the same, NaN included."""
    if isinstance(value, msgspec.Struct):
        return [bits(each) for each in msgspec.structs.astuple(value)]
    if isinstance(value, tuple):
        return [bits(each) for each in value]
    return (type(value), value.hex() if isinstance(value, float) else value)


def strict(text: bytes) -> Any:
    def refuse(constant: str) -> None:
        raise AssertionError(f"{constant} is no JSON")

    return json.loads(text, parse_constant=refuse)


@given(messages)
@settings(deadline=None)
def test_every_message_comes_back_bit_for_bit(message: All) -> None:
    codec = JsonCodec(Slot("x", All))
    text = codec.encode(message)
    assert bits(codec.decode(text)) == bits(message)
    plain = strict(text)
    assert {*plain} - {EXACT} == {*All.__struct_fields__}


@pytest.mark.parametrize("real", [math.nan, math.inf, -math.inf])
def test_what_json_has_no_number_for_stands_beside_it(real: float) -> None:
    message = Twist(linear=Vector3(x=real))
    text = JsonCodec(Slot("x", Twist)).encode(message)
    assert strict(text)["linear"] == {"x": None, "y": 0.0, "z": 0.0}
    assert strict(text)[EXACT]


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_ordinary_messages_are_what_the_schema_says_and_no_more(real: float) -> None:
    text = JsonCodec(Slot("x", Twist)).encode(Twist(linear=Vector3(x=real)))
    assert strict(text) == {
        "linear": {"x": real, "y": 0.0, "z": 0.0},
        "angular": {"x": 0.0, "y": 0.0, "z": 0.0},
    }


@pytest.mark.parametrize(
    "text", [b"", b"[]", b"null", b'{"x": ', b'{"linear": 1}', b'{"$msgpack": "?"}', b"\xff"]
)
def test_what_is_no_message_is_a_value_error(text: bytes) -> None:
    with pytest.raises(ValueError):  # noqa: PT011  of several libraries
        JsonCodec(Slot("x", Twist)).decode(text)
