"""Random definitions and values: our bytes are those of rosbags, and bad bytes are an error."""

from __future__ import annotations

import re
import tempfile
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from llfsm.bridges.ros2.errors import CdrError
from llfsm.bridges.ros2.types import RosMessage, TypeLibrary
from llfsm.bridges.ros2.types import _primitives as primitives
from thoroughness import examples

# How long an example takes says how busy the machine is, and nothing of the code.
EXAMPLES = settings(
    max_examples=examples(30), deadline=None, suppress_health_check=[HealthCheck.too_slow]
)
NUMBERS = ("byte", "char", "int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64")
PRIMITIVES = (*NUMBERS, "bool", "float32", "float64", "string", "string<=3")
NUMPY = {"byte": "uint8", "char": "uint8"}
NAMES = ("a", "from_x", "class", "x2", "data", "none", "lambda", "self")


class Kind(NamedTuple):
    """The type of a field, as drawn."""

    base: str  # a primitive, or the name of a message drawn before
    array: str  # "", "[]", "[3]" or "[<=3]"


Fields = dict[str, Kind]


@st.composite
def definitions(draw: st.DrawFn, primitives: tuple[str, ...] = PRIMITIVES) -> dict[str, Fields]:
    """Draw messages of which each may hold those before it; the last is the one to look at."""
    drawn: dict[str, Fields] = {}
    for index in range(draw(st.integers(1, 3))):
        bases = st.sampled_from([*primitives, *drawn, *drawn])
        arrays = st.sampled_from(("", "", "", "[]", "[3]", "[<=3]", "[1]"))
        kinds = st.builds(Kind, bases, arrays)
        least = 0 if index < 2 else 1
        names = draw(st.lists(st.sampled_from(NAMES), unique=True, min_size=least, max_size=6))
        drawn[f"M{index}"] = {name: draw(kinds) for name in names}
    return drawn


def text(fields: Fields) -> str:
    lines = [f"{kind.base}{kind.array} {name}\n" for name, kind in fields.items()]
    return "".join(lines) or "uint8 structure_needs_at_least_one_member\n"


def library(drawn: dict[str, Fields]) -> TypeLibrary:
    with tempfile.TemporaryDirectory() as folder:
        messages = Path(folder, "own", "msg")
        messages.mkdir(parents=True)
        for name, fields in drawn.items():
            (messages / f"{name}.msg").write_text(text(fields))
        types = TypeLibrary(share=[Path(folder)])
        types.message(f"own/msg/{list(drawn)[-1]}")
    return types


def values(types: TypeLibrary, drawn: dict[str, Fields], kind: Kind) -> st.SearchStrategy[Any]:
    base = kind.base
    if base in drawn:
        single = messages(types, drawn, base)
    elif base == "bool":
        single = st.booleans()
    elif base in ("float32", "float64"):
        single = st.floats(width=int(base[5:]))
    elif base in NUMBERS:
        single = st.integers(*primitives.PRIMITIVES[base].range)
    else:
        bound = int(base.partition("=")[2] or 10)
        single = st.text(st.characters(exclude_categories=["Cs"]), max_size=bound)
    if not kind.array:
        return single
    size = int(re.sub(r"\D", "", kind.array) or 5)
    least = size if kind.array[1].isdigit() else 0
    made = bytes if base in ("byte", "char", "uint8") else tuple
    return st.lists(single, min_size=least, max_size=size).map(made)


def messages(types: TypeLibrary, drawn: dict[str, Fields], name: str) -> st.SearchStrategy[Any]:
    kinds = {attribute(n): values(types, drawn, kind) for n, kind in drawn[name].items()}
    return st.builds(types.message(f"own/msg/{name}").message, **kinds)


def attribute(name: str) -> str:
    return f"{name}_" if name in ("class", "lambda") else name


def rosbags_store(drawn: dict[str, Fields]) -> Any:
    store = get_typestore(Stores.EMPTY)
    known = {}
    for name, fields in drawn.items():
        known |= get_types_from_msg(text(fields), f"own/msg/{name}")
    store.register(known)
    return store


def to_rosbags(store: Any, drawn: dict[str, Fields], name: str, message: Any) -> Any:
    """Make rosbags' object of a message."""

    def one(kind: Kind, value: Any) -> Any:
        if kind.base == "byte":  # of which rosbags writes a single one as an int8
            return value - 256 if value > 127 else value
        return to_rosbags(store, drawn, kind.base, value) if kind.base in drawn else value

    def field(kind: Kind, value: Any) -> Any:
        if not kind.array:
            return one(kind, value)
        if kind.base in drawn or kind.base.startswith("string"):
            return [one(kind, item) for item in value]
        return np.array(list(value), dtype=NUMPY.get(kind.base, kind.base))

    fields = {
        attribute(n): field(kind, getattr(message, attribute(n))) for n, kind in drawn[name].items()
    }
    empty = {"structure_needs_at_least_one_member": 0}
    return store.types[f"own/msg/{name}"](**(fields or empty))


def last(types: TypeLibrary, drawn: dict[str, Fields]) -> tuple[RosMessage[Any], str]:
    name = list(drawn)[-1]
    return types.message(f"own/msg/{name}"), name


@EXAMPLES
@given(st.data())
def test_bytes_are_those_of_rosbags(data):
    drawn = data.draw(definitions())
    types, store = library(drawn), rosbags_store(drawn)
    kind, name = last(types, drawn)
    message = data.draw(messages(types, drawn, name))
    theirs = to_rosbags(store, drawn, name, message)
    encoded = bytes(store.serialize_cdr(theirs, kind.name, little_endian=True))
    assert kind.encode(message) == encoded
    assert repr(kind.decode(encoded)) == repr(message)  # repr, for NaN
    swapped = bytes(store.serialize_cdr(theirs, kind.name, little_endian=False))
    assert repr(kind.decode(swapped)) == repr(message)


@EXAMPLES
@given(st.data())
def test_what_is_encoded_is_decoded(data):
    """With wide texts, which rosbags does not have."""
    drawn = data.draw(definitions((*PRIMITIVES, "wstring", "wstring", "wstring<=2")))
    types = library(drawn)
    kind, name = last(types, drawn)
    message = data.draw(messages(types, drawn, name))
    assert repr(kind.decode(kind.encode(message))) == repr(message)


def decode(kind: RosMessage[Any], data: bytes) -> Any:
    """Return the message, or the error."""
    try:
        return kind.decode(data)
    except CdrError as error:
        return error


@EXAMPLES
@given(st.data())
def test_bytes_that_are_no_message_are_an_error_that_names_the_field(data):
    drawn = data.draw(definitions((*PRIMITIVES, "wstring")))
    types = library(drawn)
    kind, name = last(types, drawn)
    encoded = kind.encode(data.draw(messages(types, drawn, name)))
    cut = encoded[: data.draw(st.integers(0, len(encoded) - 1))]
    at, byte = data.draw(st.integers(0, len(encoded) - 1)), data.draw(st.integers(0, 255))
    flipped = encoded[:at] + bytes([byte]) + encoded[at + 1 :]
    random = encoded[:4] + data.draw(st.binary(max_size=64))
    following = encoded + data.draw(st.binary(max_size=64))
    assert repr(decode(kind, following)) == repr(kind.decode(encoded))  # as in ROS 2
    for candidate in (flipped, random, cut):
        decoded = decode(kind, candidate)
        if not isinstance(decoded, CdrError):
            assert repr(kind.decode(kind.encode(decoded))) == repr(decoded)
            assert candidate is not cut
            continue
        reported = re.fullmatch(rf"own/msg/{name}: (.*)", str(decoded), re.DOTALL)
        assert reported, decoded
        field = re.match(r"(\w+)(\[\d+\])?(\.\w+(\[\d+\])?)*: ", reported[1])
        if field is not None:
            assert field[1] in map(attribute, drawn[name])
        else:
            assert re.match(r"the (header|byte of an empty message)", reported[1]), decoded
