"""Bytes: the rules of CDR one by one, and the errors for what is no message."""

import math
import struct
import tracemalloc
from array import array

import pytest

from llfsm.bridges.ros2.errors import CdrError
from llfsm.whiteboard import MessageFieldError, Slot, Whiteboard

LITTLE, BIG = bytes.fromhex("00010000"), bytes.fromhex("00000000")


@pytest.fixture
def thing(define):
    """Return the type of a definition's text."""
    return lambda text, **others: define(Thing=text, **others).message("own_msgs/msg/Thing")


def reported(kind, data: bytes) -> str:
    with pytest.raises(CdrError) as caught:
        kind.decode(data)
    return str(caught.value)


def refused(kind, **fields) -> str:
    with pytest.raises(CdrError) as caught:
        kind.encode(kind.message(**fields))
    return str(caught.value)


def test_alignment_is_counted_behind_the_header(thing):
    kind = thing("uint8 a\nfloat64 b\nuint8 c\nint16 d")
    data = kind.encode(kind.message(a=1, b=2.0, c=3, d=4))
    assert data == LITTLE + struct.pack("<B7xdBxh", 1, 2.0, 3, 4)


def test_an_empty_sequence_has_no_padding(thing):
    kind = thing("float64[] a\nuint8 b")
    assert kind.encode(kind.message(b=7)) == LITTLE + bytes([0, 0, 0, 0, 7])
    full = kind.encode(kind.message(a=(1.0,), b=7))
    assert full == LITTLE + struct.pack("<I4xdB", 1, 1.0, 7)


def test_messages_in_a_row_are_aligned_one_by_one(thing):
    kind = thing("uint8 a\nPart[] b\nPart[2] c\nuint8 d", Part="float64 x\nuint8 y")
    part = type(kind.message().c[0])
    one, two = part(x=1.0, y=2), part(x=3.0, y=4)
    data = kind.encode(kind.message(b=(one, two), c=(one, two), d=5))
    parts = struct.pack("<dB7xdB7x", 1.0, 2, 3.0, 4)
    assert data == LITTLE + struct.pack("<B3xI", 0, 2) + parts + parts[:25] + b"\5"
    assert kind.decode(data).c == (one, two)


def test_messages_in_a_row_are_not_aligned_themselves(define):
    """CDR aligns numbers alone: the padding inside a message depends on where it starts."""
    types = define(Pair="uint8 a\nint16 b", Thing="uint8[3] x\nPair[2] pairs", Many="Far[] all",
                   Far="uint8 a\nfloat64 b")  # fmt: skip
    thing, pair = types.message("own_msgs/msg/Thing"), types.message("own_msgs/msg/Pair").message
    message = thing.message(x=b"\1\2\3", pairs=(pair(a=4, b=5), pair(a=6, b=7)))
    assert thing.encode(message) == LITTLE + struct.pack("<3sBhBxh", b"\1\2\3", 4, 5, 6, 7)
    assert thing.decode(thing.encode(message)) == message
    many, far = types.message("own_msgs/msg/Many"), types.message("own_msgs/msg/Far").message
    message = many.message(all=(far(a=1, b=2.0), far(a=3, b=4.0)))
    assert many.encode(message) == LITTLE + struct.pack("<IB3xdB7xd", 2, 1, 2.0, 3, 4.0)
    assert many.decode(many.encode(message)) == message


def test_an_empty_message_is_a_byte(thing):
    kind = thing("Nothing a\nNothing[] b", Nothing="")
    nothing = type(kind.message().a)()
    data = kind.encode(kind.message(b=(nothing, nothing)))
    assert data == LITTLE + struct.pack("<B3xIBB", 0, 2, 0, 0)
    assert kind.decode(data).b == (nothing, nothing)


def test_wide_text_is_utf_16_in_units_of_four_bytes(thing):
    """As rosidl_typesupport_fastrtps_cpp writes it."""
    kind = thing("wstring w\nwstring[] many")
    data = kind.encode(kind.message(w="aΩ\N{TURTLE}", many=("", "b")))
    units = (0x61, 0x3A9, 0xD83D, 0xDC22)
    assert data == LITTLE + struct.pack("<I4I", 4, *units) + struct.pack("<IIII", 2, 0, 1, 0x62)
    assert kind.decode(data) == kind.message(w="aΩ\N{TURTLE}", many=("", "b"))


def test_an_empty_text_may_have_no_nul(thing):
    kind = thing("string s\nint8 x")
    assert kind.decode(LITTLE + struct.pack("<Ib", 0, 5)) == kind.message(s="", x=5)


def test_a_text_may_hold_a_nul(thing):
    kind = thing("string s")
    assert kind.decode(kind.encode(kind.message(s="a\0b"))).s == "a\0b"


def test_a_float32_is_rounded_and_keeps_what_is_no_number(thing):
    kind = thing("float32 x\nfloat32[] many")
    data = kind.encode(kind.message(x=0.1, many=(math.inf, -math.inf, math.nan, -0.0)))
    decoded = kind.decode(data)
    assert decoded.x == struct.unpack("f", struct.pack("f", 0.1))[0] != 0.1
    assert repr(decoded.many) == "(inf, -inf, nan, -0.0)"


@pytest.mark.parametrize("count", [1, 3, 4, 8, 100])
def test_bytes_after_the_message_are_left_alone(thing, count):
    """ROS 2 sends them for empty sequences of 8-byte numbers, and reads any."""
    kind = thing("uint8 x")
    for header in (LITTLE, b"\0\0\0\0"):
        assert kind.decode(header + b"\7" + bytes(count)).x == 7


def test_options_in_the_header_do_not_matter(thing):
    kind = thing("uint16 x")
    assert kind.decode(b"\0\1\0\2\7\0").x == 7
    assert kind.decode(b"\0\0\0\2\0\7").x == 7


@pytest.mark.parametrize("header", ["0002", "0003", "0007", "0100", "ff01"])
def test_another_encoding_is_refused(thing, header):
    data = bytes.fromhex(header) + bytes(10)
    assert "plain CDR's 00 00 or 00 01" in reported(thing("uint8 x"), data)


@pytest.mark.parametrize("size", range(4))
def test_a_header_that_is_cut(thing, size):
    assert f"the header needs 4 bytes, there are {size}" in reported(
        thing("uint8 x"), LITTLE[:size]
    )


def test_what_is_no_buffer_is_a_type_error(thing):
    with pytest.raises(TypeError):
        thing("uint8 x").decode(1000)


def le(code: str, *values: object) -> bytes:
    return LITTLE + struct.pack(f"<{code}", *values)


@pytest.mark.parametrize(
    ("text", "data", "message"),
    [
        ("int8 a\nint32 b", le("bxxxH", 1, 2), "b: needs 4 bytes at offset 8, 2 are left"),
        ("int8 a\nint32 b", le("b", 1), "b: needs 4 bytes at offset 8, 0 are left"),
        ("bool[2] a", le("BB", 1, 2), r"a[1]: a bool is 0 or 1, not 2"),
        ("bool a", le("B", 255), "a: a bool is 0 or 1, not 255"),
        ("string a", le("I", 4), "a: needs 4 bytes at offset 8, 0 are left"),
        ("string a", le("I3s", 3, b"abc"), "a: the text does not end in a NUL"),
        ("string[] a", le("II3s", 1, 3, b"abc"), "a[0]: the text does not end in a NUL"),
        ("string a", le("I3s", 3, b"a\xff\0"), "a: is not valid UTF-8"),
        ("string a", le("I4s", 4, b"\xed\xa0\x80"), "a: is not valid UTF-8"),
        ("string<=2 a", le("I4s", 4, b"abc"), "a: 3 characters, at most 2 are allowed"),
        ("string<=2[] a", le("II4s", 1, 4, b"abc"), "a[0]: 3 characters, at most 2"),
        ("wstring a", le("II", 1, 0x10000), "a: is not valid UTF-16"),
        ("wstring a", le("II", 1, 0xD800), "a: is not valid UTF-16"),
        ("wstring<=1[] a", le("IIII", 1, 2, 65, 65), "a[0]: 2 characters, at most 1"),
        ("wstring[] a", le("II", 1, 2), "a[0]: needs 8 bytes"),
        ("int32[<=2] a", le("Iiii", 3, 1, 2, 3), "a: 3 values, at most 2 are allowed"),
        ("float64[] a", le("Id", 2, 1.0), "a: needs 16 bytes at offset 12, 4 are left"),
        ("Part[] a", le("IiI", 2, 1, 9), "a[0].text: needs 9 bytes"),
        ("Part a", le("i", 2), "a.text: needs 4 bytes at offset 8, 0 are left"),
        ("Fixed[2] a", le("i", 2), "a[1].x: needs 4 bytes"),
    ],
)
def test_bytes_that_are_no_message(thing, text, data, message):
    kind = thing(text, Part="int32 x\nstring text", Fixed="int32 x")
    found = reported(kind, data)
    assert found.startswith("own_msgs/msg/Thing: ")
    assert message in found


def test_big_endian_bytes_that_are_no_message(thing):
    kind = thing("int32[<=2] a\nstring b")
    assert "a: 3 values" in reported(kind, BIG + struct.pack(">I", 3))
    assert "b: needs 5 bytes at offset 12" in reported(kind, BIG + struct.pack(">II", 0, 5))


@pytest.mark.parametrize(
    "text",
    [
        "string a",
        "string[] a",
        "wstring a",
        "wstring[] a",
        "uint8[] a",
        "bool[] a",
        "int16[] a",
        "float64[] a",
        "Fixed[] a",
        "Part[] a",
        "Nothing[] a",
    ],
)
@pytest.mark.parametrize("header", [LITTLE, BIG])
def test_a_length_beyond_the_data_allocates_nothing(thing, text, header):
    kind = thing(text, Part="int32 x\nstring text", Fixed="int32 x", Nothing="")
    data = header + b"\xff\xff\xff\xff" + bytes(64)
    reported(kind, data)  # makes what is only made once
    tracemalloc.start()
    try:
        assert "a" in reported(kind, data)
        assert tracemalloc.get_traced_memory()[1] < 100_000
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize(
    ("text", "value", "message"),
    [
        ("uint8 a", 256, "a: 256 is not of type uint8, whose range is 0 to 255"),
        ("uint64 a", -1, "a: -1 is not of type uint64"),
        ("int64 a", 2**63, "is not of type int64"),
        ("int32 a", 1.5, "a: 1.5 is not of type int32"),
        ("int32 a", None, "a: None is not of type int32"),
        ("bool a", "no", "a: 'no' is not of type bool"),
        ("bool a", 2, "a: 2 is not of type bool"),
        ("bool[] a", (True, 2), "a[1]: 2 is not of type bool"),
        ("float32 a", 1e300, "a: 1e+300 is not of type float32"),
        ("float64 a", "1", "a: '1' is not of type float64"),
        ("string a", b"x", "a: a str is needed, not b'x'"),
        ("string a", "\ud800", "a: half a character cannot be encoded"),
        ("wstring a", "\ud800", "a: half a character cannot be encoded"),
        ("wstring[] a", ("\ud800",), "a[0]: half a character cannot be encoded"),
        ("string<=2 a", "abc", "a: 3 characters, at most 2 are allowed"),
        ("wstring<=2 a", "abc", "a: 3 characters, at most 2 are allowed"),
        ("string<=2[] a", ("", "abc"), "a[1]: 3 characters, at most 2 are allowed"),
        ("wstring<=2[] a", ("", "abc"), "a[1]: 3 characters, at most 2 are allowed"),
        ("string[] a", "abc", "a: tuple is needed, not str"),
        ("int32[] a", (1, 2**31), "a[1]: 2147483648 is not of type int32"),
        ("float32[] a", (1e300,), "a[0]: 1e+300 is not of type float32"),
        ("int32[2] a", (1,), "a: 1 values, exactly 2 are needed"),
        ("int32[<=1] a", (1, 2), "a: 2 values, at most 1 are allowed"),
        ("uint8[] a", "abc", "a: bytes is needed, not str"),
        ("uint8[] a", (1, 2), "a: bytes is needed, not tuple"),
        ("uint8[3] a", b"ab", "a: 2 values, exactly 3 are needed"),
        ("uint8[3] a", b"abcd", "a: 4 values, exactly 3 are needed"),
        ("Fixed a", None, "a.x: a NoneType has no such field"),
        ("Fixed[] a", (None,), "a[0].x: a NoneType has no such field"),
        ("Part[] a", (None,), "a[0].x: a NoneType has no such field"),
    ],
)
def test_messages_that_cannot_be_bytes(thing, text, value, message):
    kind = thing(text, Part="int32 x\nstring text", Fixed="int32 x\nuint8[2] pair")
    found = refused(kind, a=value)
    assert found.startswith("own_msgs/msg/Thing: ")
    assert message in found


def test_bytes_of_a_wrong_size_in_a_row(thing):
    """Where struct itself would cut or fill them."""
    kind = thing("Fixed[] a", Fixed="uint8[2] pair")
    fixed = kind.message.__annotations__["a"].__args__[0]
    assert "a[0].pair: 3 values, exactly 2 are needed" in refused(kind, a=(fixed(b"123"),))


def test_a_keyword_is_a_field_with_an_underscore(thing):
    kind = thing("float32 from\nbool class\nstring lambda")
    message = kind.message(from_=2.0, class_=True, lambda_="x")
    assert kind.decode(kind.encode(message)) == message


@pytest.mark.parametrize(
    ("field", "given", "held"),
    [
        ("int32[] a", [1, 2], (1, 2)),
        ("float64[] a", array("d", [1.5, 2.5]), (1.5, 2.5)),
        ("float32[2] a", array("f", [1.5, 2.5]), (1.5, 2.5)),
        ("int16[] a", array("h", range(6)), (*range(6),)),
        ("uint8[] a", bytearray(b"abc"), b"abc"),
        ("uint8[3] a", memoryview(b"abc"), b"abc"),
        ("uint8[] a", array("B", b"abc"), b"abc"),
        ("string[] a", ["x", "y"], ("x", "y")),
    ],
)
def test_sequences_and_buffers_are_taken_for_what_a_field_holds(define, field, given, held):
    kind = define(Thing=field).message("own_msgs/msg/Thing")
    message = kind.message(a=given)
    assert kind.decode(kind.encode(message)) == kind.message(a=held)
    board, slot = Whiteboard.local(), Slot("thing", kind.message)
    board.add_message(slot, message)
    assert board.get_message(slot) == kind.message(a=held)


def test_so_are_those_of_messages_inside(define):
    types = define(Thing="Inner[] a", Inner="float32[] b")
    inner = types.message("own_msgs/msg/Inner").message
    kind = types.message("own_msgs/msg/Thing")
    message = kind.message(a=[inner(b=[1.0]), inner(b=array("f", [2.0]))])
    expected = kind.message(a=(inner(b=(1.0,)), inner(b=(2.0,))))
    assert kind.decode(kind.encode(message)) == expected


@pytest.mark.parametrize(
    ("field", "given"),
    [
        ("int32[] a", object()),
        ("int32[] a", array("d", [0.5])),
        ("uint8[] a", array("h", [1])),
        ("int32[2] a", [1]),
        ("string[] a", [1]),
        ("int8[] a", array("h", [1000])),
    ],
)
def test_others_are_refused_as_before(define, field, given):
    kind = define(Thing=field).message("own_msgs/msg/Thing")
    with pytest.raises(CdrError, match=r"a: |a\[0\]: "):
        kind.encode(kind.message(a=given))
    with pytest.raises(MessageFieldError):
        Whiteboard.local().add_message(Slot("thing", kind.message), kind.message(a=given))
