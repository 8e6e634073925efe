"""Messages to bytes and back, and what cannot be laid out."""

from __future__ import annotations

import ctypes
import math
import struct
from enum import IntEnum
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from llfsm.bridges.gusimplewhiteboard import LayoutError, MisfitError, find_layout
from llfsm.bridges.gusimplewhiteboard._structures import MessageLayout
from llfsm.whiteboard import Message, Slot
from llfsm.whiteboard.messages.geometry_msgs import Point, Twist, Vector3
from llfsm.whiteboard.messages.types import Int16, UInt8
from llfsm.whiteboard.schema import from_plain


class Mode(IntEnum):
    OFF = 0
    ON = 1


class Robot(Message):
    name: str = ""
    on: bool = False
    battery: float = 0.0
    steps: Int16 = 0
    place: Point = Point()
    code: bytes = b"\0\0\0\0"


class Arm(Message):
    joints: tuple[float, float, float] = (0.0, 0.0, 0.0)
    raw: tuple[UInt8, ...] = (0,) * 4
    ends: tuple[Point, Point] = (Point(), Point())
    mode: Mode = Mode.OFF
    label: str = ""
    data: bytes = b"\0\0"


class CPoint(ctypes.Structure):
    _fields_ = (("x", ctypes.c_double), ("y", ctypes.c_double), ("z", ctypes.c_float))


class CArm(ctypes.Structure):
    _fields_ = (
        ("joints", ctypes.c_double * 3),
        ("_spare", ctypes.c_int),
        ("raw", ctypes.c_uint8 * 4),
        ("ends", CPoint * 2),
        ("mode", ctypes.c_uint8),
        ("label", ctypes.c_char * 8),
        ("data", ctypes.c_uint8 * 2),
    )


class CBits(ctypes.Structure):
    _fields_ = (("steps", ctypes.c_int16, 4),)


class CBitsAndName(CBits):
    _fields_ = (("name", ctypes.c_char),)


class CNumber(ctypes.Structure):
    _fields_ = (("battery", ctypes.c_float), ("on", ctypes.c_bool))


class CWrongName(ctypes.Structure):
    _fields_ = (("volts", ctypes.c_float),)


class CWrongType(ctypes.Structure):
    _fields_ = (("battery", ctypes.c_int),)


class CPointer(ctypes.Structure):
    _fields_ = (("name", ctypes.c_char_p),)


class CShort(ctypes.Structure):
    _fields_ = (("joints", ctypes.c_double * 2),)


class CLarge(ctypes.Structure):
    _fields_ = (("name", ctypes.c_char * 129),)


ROBOT, ARM = Slot("robot", Robot), Slot("arm", Arm)


def here(structure: type) -> str:
    return f"{__name__}:{structure.__name__}"


def back(layout: MessageLayout, slot: Slot[Any], message: Message) -> Message:
    plain = from_plain(layout.decode(layout.encode(message)), slot.schema)
    return msgspec.convert(plain, slot.type)  # type: ignore[no-any-return]


robots = st.builds(
    Robot,
    st.text(st.characters(min_codepoint=1, exclude_categories=["Cs"]), max_size=4),
    st.booleans(),
    st.floats(allow_nan=False),
    st.integers(-(2**15), 2**15 - 1),
    st.builds(Point, st.floats(width=32, allow_nan=False), st.just(0.0), st.just(2.5)),
    st.binary(min_size=4, max_size=4),
)


@given(robots)
def test_a_format_loses_nothing(robot: Robot) -> None:
    layout = find_layout("<16s?dh3f4s", ROBOT.schema)
    assert layout.size == struct.calcsize("<16s?dh3f4s")
    assert back(layout, ROBOT, robot) == robot


arms = st.builds(
    Arm,
    st.tuples(*[st.floats(allow_nan=False)] * 3),
    st.tuples(*[st.integers(0, 255)] * 4),
    st.tuples(*[st.builds(Point, st.floats(allow_nan=False), st.just(1.0), st.just(0.5))] * 2),
    st.sampled_from(Mode),
    st.text("abcä", max_size=4),
    st.binary(min_size=2, max_size=2),
)


@given(arms)
def test_a_structure_loses_nothing(arm: Arm) -> None:
    assert back(find_layout(here(CArm), ARM.schema), ARM, arm) == arm


def test_a_format_is_what_it_says() -> None:
    schema = Slot("t", Twist).schema
    twist = Twist(Vector3(1.0, 2.0, 3.0), Vector3(4.0, 5.0, 6.0))
    assert find_layout("<6d", schema).encode(twist) == struct.pack("<6d", *range(1, 7))
    some = find_layout("<fx2xf", schema, ["angular.z", "linear.x"])
    assert some.encode(twist) == struct.pack("<fx2xf", 6.0, 1.0)
    assert some.decode(struct.pack("<fx2xf", 7, 8)) == {"angular": {"z": 7.0}, "linear": {"x": 8.0}}


def test_inherited_fields_and_bits() -> None:
    layout = find_layout(here(CBitsAndName), ROBOT.schema)
    robot = Robot(name="x", steps=-3)
    assert layout.decode(layout.encode(robot)) == {"steps": -3, "name": "x"}
    assert layout.decode(layout.encode(Robot())) == {"steps": 0, "name": ""}
    with pytest.raises(MisfitError, match="steps: 8 does not fit"):
        layout.encode(Robot(steps=8))


def test_what_is_not_finite_passes() -> None:
    layout = find_layout(here(CNumber), ROBOT.schema)
    assert layout.decode(layout.encode(Robot(battery=math.inf)))["battery"] == math.inf
    assert math.isnan(layout.decode(layout.encode(Robot(battery=math.nan)))["battery"])


@pytest.mark.parametrize(
    ("layout", "message", "what"),
    [
        ("<4s?dh3f4s", Robot(name="12345"), "name: 5 bytes do not fit into 4"),
        ("<4s?fh3f4s", Robot(battery=1e300), "float too large"),
        ("<4s?db3f4s", Robot(steps=128), "byte format requires|'b' format requires"),
        (here(CNumber), Robot(battery=1e300), r"battery: 1e\+300 does not fit into a c_float"),
        (here(CArm), Arm(label="123456789"), "label: 9 bytes or values do not fit into 8"),
        (here(CArm), Arm(raw=(1,) * 5), "raw: 5 bytes or values do not fit into 4"),
    ],
)
def test_a_value_that_does_not_fit(layout: str, message: Message, what: str) -> None:
    with pytest.raises(MisfitError, match=what):
        find_layout(layout, Slot("s", type(message)).schema).encode(message)


def test_bytes_that_are_no_text() -> None:
    layout = find_layout("2s", ROBOT.schema, ["name"])
    with pytest.raises(MisfitError, match="name: not UTF-8"):
        layout.decode(b"\xff\xff")


@pytest.mark.parametrize(
    ("layout", "fields", "slot", "what"),
    [
        ("<6y", None, ROBOT, "'<6y' is not a struct format: bad char"),
        ("<2d", None, ROBOT, "2 values for 8 fields: name, on, battery, steps, place.x"),
        ("<d", ["volts"], ROBOT, "Robot has no field 'volts': name, on"),
        ("<d", ["name.x"], ROBOT, "Robot has no field 'name.x'"),
        ("<d", ["place"], ROBOT, "place is not a single value; use a ctypes structure"),
        ("<d", ["steps"], ROBOT, "'d' cannot hold steps, which is of type integer"),
        ("P", ["steps"], ROBOT, "'P' has no meaning in another process"),
        ("<129s", ["name"], ROBOT, "takes 129 bytes; a gusimplewhiteboard's message has 128"),
        (here(CLarge), None, ROBOT, "takes 129 bytes"),
        (here(CNumber), ["battery"], ROBOT, "a structure has field names of its own"),
        (here(CWrongName), None, ROBOT, "CWrongName: Robot has no field 'volts'"),
        (here(CWrongType), None, ROBOT, "c_int cannot hold battery, which is of type number"),
        (here(CPointer), None, ROBOT, "c_char_p cannot hold name, which is of type string"),
        (here(CShort), None, ARM, "c_double_Array_2 cannot hold joints, which is of type array"),
        ("no_such_module:X", None, ROBOT, "no ctypes structure 'no_such_module:X'"),
        (here(CNumber) + "X", None, ROBOT, "no ctypes structure"),
        (here(Robot), None, ROBOT, "is not a ctypes structure"),
    ],
)
def test_a_layout_that_does_not_match(
    layout: str, fields: list[str] | None, slot: Slot[Any], what: str
) -> None:
    with pytest.raises(LayoutError, match=what):
        find_layout(layout, slot.schema, fields)
