"""The layout of a message's values in the bytes of another program's struct.

A layout is a format of Python's ``struct``, with the message's fields in their order, or a ctypes
structure, whose fields have the names of the message's fields.
"""

from __future__ import annotations

import importlib
import re
import struct
from collections.abc import Sequence
from operator import attrgetter
from typing import Any, NamedTuple, Protocol

from llfsm.whiteboard import Message
from llfsm.whiteboard.schema import Schema

from .errors import LayoutError, MisfitError
from .file import MESSAGE_SIZE
from .structures import StructureLayout, is_structure, raw, text_of

__all__ = ["MessageLayout", "StructLayout", "find_layout"]

_VALUE = re.compile(r"(\d*)([a-zA-Z?])")
_CODES = {"boolean": "?", "integer": "bBhHiIlLqQnN", "number": "efd", "string": "sc"}


class MessageLayout(Protocol):
    """Encodes messages into bytes, and decodes bytes into a message's fields."""

    size: int

    def encode(self, message: Message) -> bytes:
        """Return the message's bytes; raise :class:`.MisfitError` if a value does not fit."""

    def decode(self, data: bytes) -> dict[str, object]:
        """Return the fields, nested messages as dicts; raise :class:`.MisfitError`."""


def find_layout(text: str, schema: Schema, fields: Sequence[str] | None = None) -> MessageLayout:
    """Return the layout that `text` names, a format or ``module:Structure``, for a schema.

    `fields` are the message's, as ``linear.x``, in the order of a format's values; by default all.
    Raise :class:`.LayoutError`.
    """
    module, colon, name = text.partition(":")
    layout: MessageLayout
    if not colon:
        layout = StructLayout(text, schema, fields)
    elif fields is not None:
        raise LayoutError(f"{text}: a structure has field names of its own; leave `fields` out")
    else:
        try:
            found = getattr(importlib.import_module(module), name)
        except (ImportError, AttributeError, ValueError) as error:
            raise LayoutError(f"no ctypes structure {text!r}: {error}") from error
        if not is_structure(found):
            raise LayoutError(f"{text!r} is not a ctypes structure")
        layout = StructureLayout(found, schema)
    if layout.size > MESSAGE_SIZE:
        raise LayoutError(
            f"{text!r} takes {layout.size} bytes; a gusimplewhiteboard's message has {MESSAGE_SIZE}"
        )
    return layout


class StructLayout:
    """A layout given by a format of Python's ``struct``."""

    def __init__(self, text: str, schema: Schema, fields: Sequence[str] | None = None) -> None:
        try:
            self._struct = struct.Struct(text)
        except struct.error as error:
            raise LayoutError(f"{text!r} is not a struct format: {error}") from error
        self.size = self._struct.size
        paths = _leaves(schema) if fields is None else list(fields)
        codes = _codes(text)
        if len(codes) != len(paths):
            raise LayoutError(
                f"{text!r} has {len(codes)} values for {len(paths)} fields: {', '.join(paths)}"
            )
        self._values = [
            _value(text, path, code, width, schema)
            for path, (code, width) in zip(paths, codes, strict=True)
        ]

    def encode(self, message: Message) -> bytes:
        """Return the message's bytes."""
        laid: list[object] = []
        for path, width, _ in self._values:
            value = raw(attrgetter(path)(message))
            if width is not None and isinstance(value, bytes) and len(value) > width:
                # pack would truncate it
                raise MisfitError(f"{path}: {len(value)} bytes do not fit into {width}")
            laid.append(value)
        try:
            return self._struct.pack(*laid)
        except (struct.error, OverflowError) as error:
            raise MisfitError(f"{self._struct.format}: {error}") from error

    def decode(self, data: bytes) -> dict[str, object]:
        """Return the fields."""
        plain: dict[str, Any] = {}
        for (path, _, is_text), value in zip(self._values, self._struct.unpack(data), strict=True):
            *outer, name = path.split(".")
            inner = plain
            for each in outer:
                inner = inner.setdefault(each, {})
            inner[name] = text_of(value, path) if is_text else value
        return plain


class _Value(NamedTuple):
    path: str
    """The field, as ``linear.x``."""
    width: int | None
    """The number of bytes of a text or raw bytes, else None."""
    is_text: bool


def _value(text: str, path: str, code: str, width: int | None, schema: Schema) -> _Value:
    leaf = _leaf(schema, path)
    kind = leaf.get("type", "")
    if code not in _CODES.get(kind, code):
        raise LayoutError(f"{text!r}: {code!r} cannot hold {path}, which is of type {kind}")
    return _Value(path, width, width is not None and "contentEncoding" not in leaf)


def _codes(text: str) -> list[tuple[str, int | None]]:
    """Return each value's code, and its width if it consists of bytes."""
    codes: list[tuple[str, int | None]] = []
    for number, code in _VALUE.findall(text):
        if code in "pP":
            raise LayoutError(f"{text!r}: {code!r} has no meaning in another process")
        if code == "s":
            codes.append((code, int(number or 1)))
        elif code != "x":
            codes += [(code, 1 if code == "c" else None)] * int(number or 1)
    return codes


def _leaves(schema: Schema, path: str = "") -> list[str]:
    found: list[str] = []
    for name, inner in schema["properties"].items():
        found += _leaves(inner, f"{path}{name}.") if "properties" in inner else [path + name]
    return found


def _leaf(schema: Schema, path: str) -> Schema:
    leaf = schema
    for name in path.split("."):
        there = leaf.get("properties", {})
        if name not in there:
            raise LayoutError(
                f"{schema['title']} has no field {path!r}: {', '.join(_leaves(schema))}"
            )
        leaf = there[name]
    if leaf.get("type") in ("object", "array"):
        raise LayoutError(f"{path} is not a single value; use a ctypes structure")
    return leaf
