"""The text of a class from a slot's schema makes a type with that schema."""

from __future__ import annotations

import enum
from importlib import import_module
from pkgutil import iter_modules
from typing import Annotated, Any, Literal

import pytest
from msgspec import Meta

import llfsm.whiteboard.messages as shipped
from llfsm.bridges.edit.message_types import class_name, message_class_text
from llfsm.whiteboard import Message
from llfsm.whiteboard.schema import describe


class Mode(enum.Enum):
    ON = "on"
    OFF = 'o"ff'


class Point(Message):
    x: float = 0.0
    y: float = 0.0


class Everything(Message, type_name="my_robot/msg/Everything"):
    mode: Mode
    gear: Literal[1, 2, "ré"]
    name: Annotated[str, Meta(min_length=1, max_length=9)]
    share: Annotated[float, Meta(ge=-1.5, lt=7)]
    parts: Annotated[tuple[Point, ...], Meta(max_length=3)] = ()
    three: tuple[int, Point, float] = (0, Point(), 0.0)
    maybe: int | str | None = None
    data: Annotated[bytes, Meta(min_length=0)] = b""
    tags: frozenset[str] = frozenset()
    hot: bool = False


class Bare(Message):
    pass


def made(schema: dict[str, Any]) -> type[Message]:
    names: dict[str, Any] = {}
    exec(compile(message_class_text(schema), "text", "exec", dont_inherit=True), names)
    found: type[Message] = names[class_name(schema["title"])]
    return found


def messages() -> list[type[Message]]:
    modules = [
        import_module(f"{shipped.__name__}.{each.name}") for each in iter_modules(shipped.__path__)
    ]
    found = [each for module in modules for each in vars(module).values() if isinstance(each, type)]
    kinds = {
        repr(each): each for each in found if issubclass(each, Message) and each is not Message
    }
    return [kinds[name] for name in sorted(kinds)]


@pytest.mark.parametrize("kind", [Everything, Point, Bare, *messages()])
def test_it_has_the_schema_that_it_was_made_from(kind: type[Message]) -> None:
    assert describe(made(describe(kind))) == describe(kind)


def test_fields_have_defaults_if_0_or_nothing_is_a_value() -> None:
    class Level(Message):
        low: Annotated[int, Meta(ge=-3, le=0)] = -1
        mode: Mode = Mode.ON
        maybe: Point | None = Point()

    assert repr(made(describe(Level))()) == "Level(low=0, mode='o\"ff', maybe=None)"
    text = message_class_text(describe(Everything))
    assert "share: Annotated[float, Meta(ge=-1.5, lt=7)] = 0.0\n" in text
    assert 'mode: Literal["o\\"ff", "on"]\n' in text
    assert "parts: Annotated[tuple[Point, ...], Meta(max_length=3)] = ()\n" in text


@pytest.mark.parametrize(
    "schema",
    [
        {"title": "not a name", "type": "object", "properties": {}, "required": []},
        {"title": "M", "type": "object", "properties": {"class": {"type": "null"}}},
        {
            "title": "M",
            "type": "object",
            "properties": {"a": {"type": "string", "pattern": "(a*)*b"}},
        },
        {
            "title": "M",
            "type": "object",
            "properties": {"inner": {"title": "a/M", "type": "object", "properties": {}}},
        },
    ],
)
def test_what_python_cannot_name_has_no_text(schema: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=r"cannot be a name|two types|a pattern"):
        message_class_text(schema)
