"""How a message's values lie in the bytes of another program's struct.

A layout is a format of Python's ``struct``, whose values are the message's fields in their order,
or a ctypes structure, whose fields have the names of the message's.
"""

from __future__ import annotations

import importlib
import re
import struct
from collections.abc import Sequence
from typing import Protocol

from llfsm.whiteboard import Message
from llfsm.whiteboard.schema import Schema

from .errors import LayoutError, MisfitError
from .file import MESSAGE_SIZE
from .structures import StructureLayout, is_structure, raw, text_of

__all__ = ["Layout", "StructLayout", "find_layout"]

_VALUE = re.compile(r"(\d*)([a-zA-Z?])")
_CODES = {"boolean": "?", "integer": "bBhHiIlLqQnN", "number": "efd", "string": "sc"}


class Layout(Protocol):
    """What turns messages into bytes, and bytes into what a message is made of."""

    size: int

    def encode(self, message: Message) -> bytes:
        """Lay a message out; raise :class:`.MisfitError` if a value does not fit."""

    def decode(self, data: bytes) -> dict[str, object]:
        """Return the fields, nested messages as dicts; raise :class:`.MisfitError`."""


def find_layout(text: str, schema: Schema, fields: Sequence[str] | None = None) -> Layout:
    """Return the layout that `text` names, a format or ``module:Structure``, for a schema.

    `fields` are the message's, as ``linear.x``, in the order of a format's values; by default all.
    Raise :class:`.LayoutError`.
    """
    module, colon, name = text.partition(":")
    layout: Layout
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
            raise LayoutError(f"{text!r} is no ctypes structure")
        layout = StructureLayout(found, schema)
    if layout.size > MESSAGE_SIZE:
        raise LayoutError(
            f"{text!r} takes {layout.size} bytes; a gusimplewhiteboard's message has {MESSAGE_SIZE}"
        )
    return layout


class StructLayout:
    """A layout by a format of Python's ``struct``."""

    def __init__(self, text: str, schema: Schema, fields: Sequence[str] | None = None) -> None:
        try:
            self._struct = struct.Struct(text)
        except struct.error as error:
            raise LayoutError(f"{text!r} is no struct format: {error}") from error
        self.size = self._struct.size
        self._paths = list(_leaves(schema)) if fields is None else list(fields)
        codes = list(_codes(text))
        if len(codes) != len(self._paths):
            raise LayoutError(
                f"{text!r} has {len(codes)} values for {len(self._paths)} fields: "
                f"{', '.join(self._paths)}"
            )
        self._widths: list[int | None] = []  # of texts
        self._is_text: list[bool] = []  # else raw bytes
        for path, (code, width) in zip(self._paths, codes, strict=True):
            leaf = _leaf(schema, path)
            if code not in _CODES.get(leaf.get("type", ""), code):
                raise LayoutError(
                    f"{text!r}: {code!r} cannot hold {path}, which is of type {leaf['type']}"
                )
            self._widths.append(width)
            self._is_text.append("contentEncoding" not in leaf)

    def encode(self, message: Message) -> bytes:
        """Lay a message out."""
        values: list[object] = []
        for path, width in zip(self._paths, self._widths, strict=True):
            value: object = message
            for name in path.split("."):
                value = getattr(value, name)
            value = raw(value)
            if width is not None and isinstance(value, bytes) and len(value) > width:
                # which pack would cut short
                raise MisfitError(f"{path}: {len(value)} bytes do not fit into {width}")
            values.append(value)
        try:
            return self._struct.pack(*values)
        except (struct.error, OverflowError) as error:
            raise MisfitError(f"{self._struct.format}: {error}") from error

    def decode(self, data: bytes) -> dict[str, object]:
        """Return the fields that lie in bytes."""
        plain: dict[str, object] = {}
        values = self._struct.unpack(data)
        for path, value, is_text in zip(self._paths, values, self._is_text, strict=True):
            *outer, name = path.split(".")
            inner = plain
            for each in outer:
                inner = inner.setdefault(each, {})  # type: ignore[assignment]
            inner[name] = text_of(value, path) if is_text else value
        return plain


def _codes(text: str) -> list[tuple[str, int | None]]:
    """Return each value's code, and its width if it is a text."""
    codes: list[tuple[str, int | None]] = []
    for number, code in _VALUE.findall(text):
        if code in "pP":
            raise LayoutError(f"{text!r}: {code!r} means nothing to another process")
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
        raise LayoutError(f"{path} is no single value; a ctypes structure can hold it")
    return leaf
