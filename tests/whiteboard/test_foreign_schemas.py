"""A schema that another process has written costs its readers neither time nor memory."""

from __future__ import annotations

from collections.abc import Iterator
from html import unescape
from pathlib import Path
from typing import Annotated, Any

import msgspec
import pytest

from llfsm.whiteboard import Message, MessageTypeError, Slot, Whiteboard
from llfsm.whiteboard.message import type_from_schema
from llfsm.whiteboard.messages.std_msgs import Bool
from llfsm.whiteboard.poller import BoardPoller
from llfsm.whiteboard.schema import describe, fingerprint, from_plain

pytestmark = pytest.mark.timeout(60)  # some of these would take until the end of the world

EVIL = "^(a+)+$"
TEXT = "a" * 50 + "!"


class Name(Message):
    text: str


class Zeros(Message):
    data: tuple[float, ...] = ()


@pytest.fixture
def board(tmp_path: Path) -> Iterator[Whiteboard]:
    with Whiteboard("board", directory=tmp_path) as board:
        yield board


def message(fields: dict[str, Any]) -> dict[str, Any]:
    return {"title": "Odd", "type": "object", "properties": fields, "required": list(fields)}


def nested(depth: int, inner: dict[str, Any]) -> dict[str, Any]:
    for _ in range(depth):
        inner = message({"a": inner})
    return inner


def make_slot(board: Whiteboard, name: str, schema: dict[str, Any], value: Message) -> None:
    """Make a slot with a schema that no class of ours has, as a program in C may."""
    slot = Slot(name, type(value))
    slot.schema = schema
    vars(slot)["fingerprint"] = fingerprint(schema)
    board.add_message(slot, value)


def test_a_pattern_of_another_process_is_not_run(board: Whiteboard) -> None:
    make_slot(board, "evil", message({"text": {"type": "string", "pattern": EVIL}}), Name(TEXT))
    slot = board.find("evil")
    assert board.get_message(slot) == slot.type(TEXT)  # type: ignore[call-arg]
    assert board.add_message(slot, slot.type(TEXT + "?")) == 2  # type: ignore[call-arg]
    (polled,) = BoardPoller(board).poll()
    assert polled.sample is not None
    assert polled.sample.message.text == TEXT + "?"  # type: ignore[attr-defined]


def test_a_pattern_of_ones_own_is_run(board: Whiteboard) -> None:
    class Code(Message):
        text: Annotated[str, msgspec.Meta(pattern="^[a-z]$")]

    board.add_message(Slot("code", Code), Code("a"))
    with pytest.raises(Exception, match="pattern"):
        board.add_message(Slot("code", Code), Code("A"))
    # One that binds the slot by its schema alone has the same type all the same.
    assert board.find("code").schema == describe(Code)
    assert board.find("code").fingerprint == Slot("code", Code).fingerprint


@pytest.mark.parametrize("depth", [70, 400, 9000])
def test_a_deep_schema_makes_a_slot_unusable_and_no_other(board: Whiteboard, depth: int) -> None:
    slot = Slot("deeper", Zeros)
    vars(slot)["type_name"], vars(slot)["fingerprint"] = "Odd", 1
    text = '{"a":' * depth + "1" + "}" * depth
    slot.schema = msgspec.Raw(text.encode())  # type: ignore[assignment]
    board.add_message(slot, Zeros())
    board.add_message(Slot("lamp", Bool), Bool(True))
    infos = {info.name: info for info in board.slots()}
    assert "deep" in infos["deeper"].problem or "recursion" in infos["deeper"].problem
    with pytest.raises(MessageTypeError):
        board.find("deeper")
    polled = {each.name: each for each in BoardPoller(board).poll()}
    assert polled["deeper"].problem
    assert polled["lamp"].sample is not None
    table = unescape(board._repr_html_())
    assert infos["deeper"].problem[:150] in table
    assert '{"data":true}' in table
    assert board.get_message(board.find("lamp")).data is True  # type: ignore[union-attr]


@pytest.mark.parametrize(
    ("schema", "why"),
    [
        (nested(33, {"type": "integer"}), "nested more than 64 deep"),
        (nested(5000, {"type": "integer"}), "nested more than 64 deep"),
        (message({f"f{i}": {"type": "null"} for i in range(20_000)}), "more than 20000 members"),
        (message({"a": {"enum": [*range(20_000)]}}), "more than 20000 members"),
    ],
)
def test_a_schema_that_is_too_large_is_refused(schema: dict[str, Any], why: str) -> None:
    with pytest.raises(MessageTypeError, match=why):
        type_from_schema(schema)


def test_a_schema_of_a_usual_size_is_not(board: Whiteboard) -> None:
    type_from_schema(nested(30, {"type": "integer"}))
    type_from_schema(message({f"f{i}": {"type": "number"} for i in range(5000)}))


def test_shared_parts_count_each_time() -> None:
    """A schema of a few lines in Python, with references, can be of gigabytes as text."""
    part: dict[str, Any] = {"type": "integer"}
    for _ in range(25):
        part = {"type": "array", "prefixItems": [part, part], "items": False}
    with pytest.raises(MessageTypeError, match="more than 20000 members"):
        type_from_schema(message({"a": part}))


@pytest.mark.parametrize(
    "field",
    [
        {"type": "array", "items": {"type": "number"}, "minItems": 1 << 40},
        {
            "type": "array",
            "minItems": 1 << 12,
            "items": {"type": "array", "items": {"type": "number"}, "minItems": 1 << 12},
        },
        {
            "type": "array",
            "minItems": 1 << 12,
            "items": message(
                {"a": {"type": "array", "items": {"type": "number"}, "minItems": 4096}}
            ),
        },
        {"type": "string", "contentEncoding": "base64", "minLength": 1 << 40},
    ],
)
def test_what_a_text_leaves_out_takes_no_gigabytes(field: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match="leaves out millions of values"):
        from_plain({}, message({"a": field}))
    few = message({"a": {"type": "array", "items": {"type": "integer"}, "minItems": 1000}})
    assert from_plain({}, few) == [[0] * 1000]


def test_many_small_omissions_are_one_large_one() -> None:
    part = message({"a": {"type": "array", "items": {"type": "number"}, "minItems": 1 << 16}})
    schema = message({"parts": {"type": "array", "items": part}})
    assert len(from_plain({"parts": [{}] * 10}, schema)[0]) == 10
    with pytest.raises(ValueError, match="leaves out millions of values"):
        from_plain({"parts": [{}] * 1000}, schema)
