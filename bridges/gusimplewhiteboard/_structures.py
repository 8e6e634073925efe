"""The layout of a message's values in the bytes of another program's struct.

A layout is a format of Python's ``struct``, with the message's fields in their order, or a ctypes
structure, whose fields have the names of the message's fields. Whether it fits a message's type is
checked when it is found; whether a value fits, when it is encoded: C would truncate it.
"""

from __future__ import annotations

import ctypes
import importlib
import math
import re
import struct
from collections.abc import Sequence
from enum import Enum
from operator import attrgetter
from typing import Any, NamedTuple, TypeAlias, TypeGuard

from llfsm.bridges.gusimplewhiteboard.errors import LayoutError, MisfitError
from llfsm.bridges.gusimplewhiteboard.file import MESSAGE_SIZE
from llfsm.whiteboard import Message
from llfsm.whiteboard.schema import Schema

_VALUE = re.compile(r"(\d*)([a-zA-Z?])")
_CODES = {"boolean": "?", "integer": "bBhHiIlLqQnN", "number": "efd", "string": "sc"}
_KINDS: dict[str, tuple[type, ...]] = {
    "boolean": (ctypes.c_bool,),
    "integer": (
        ctypes.c_int8, ctypes.c_int16, ctypes.c_int32, ctypes.c_int64, ctypes.c_longlong,
        ctypes.c_uint8, ctypes.c_uint16, ctypes.c_uint32, ctypes.c_uint64, ctypes.c_ulonglong,
    ),
    "number": (ctypes.c_float, ctypes.c_double),
}  # fmt: skip
_SCALARS = tuple(kind for kinds in _KINDS.values() for kind in kinds)


def find_layout(text: str, schema: Schema, fields: Sequence[str] | None = None) -> MessageLayout:
    """Find the layout that `text` names, a format or ``module:Structure``, for a schema.

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


def is_structure(kind: object) -> TypeGuard[type[ctypes.Structure]]:
    """Check that `kind` is a class of ctypes structures."""
    return isinstance(kind, type) and issubclass(kind, ctypes.Structure)


class StructureLayout:
    """A layout given by a ctypes structure; fields whose names begin with ``_`` are ignored."""

    def __init__(self, kind: type[ctypes.Structure], schema: Schema) -> None:
        _check(kind, schema, "")
        self.size = ctypes.sizeof(kind)
        self._kind = kind
        self._schema = schema

    def encode(self, message: Message) -> bytes:
        """Encode a message; raise :class:`.MisfitError` if a value does not fit."""
        return bytes(_fill(self._kind, message, ""))

    def decode(self, data: bytes) -> dict[str, object]:
        """Decode the fields, nested messages as dicts; raise :class:`.MisfitError`."""
        plain = _plain(self._kind.from_buffer_copy(data), self._schema, "")
        assert isinstance(plain, dict)
        return plain


def _fields(kind: type[ctypes.Structure]) -> dict[str, Any]:
    """Return the type of each field of a message, inherited ones first."""
    return {
        name: inner
        for cls in reversed(kind.__mro__)
        for name, inner, *_ in vars(cls).get("_fields_", ())
        if not name.startswith("_")
    }


def _check(kind: Any, schema: Schema, path: str) -> None:
    """Raise :class:`.LayoutError` if a value of the schema cannot be one of `kind`."""
    wanted = schema.get("type")
    match schema:
        case {"properties": properties} if is_structure(kind):
            for name, inner in _fields(kind).items():
                where = f"{path}.{name}".lstrip(".")
                if name not in properties:
                    raise LayoutError(
                        f"{kind.__name__}: {schema['title']} has no field {where!r}: "
                        f"{', '.join(properties)}"
                    )
                _check(inner, properties[name], where)
            return
        case {"contentEncoding": _}:
            if _is_array(kind) and kind._type_ is ctypes.c_uint8:
                return
        case {"type": "string"}:
            if kind is ctypes.c_char or (_is_array(kind) and kind._type_ is ctypes.c_char):
                return
        case {"prefixItems": items}:
            if _is_array(kind) and kind._length_ == len(items):
                for number, item in enumerate(items):
                    _check(kind._type_, item, f"{path}[{number}]")
                return
        case {"items": item}:
            if _is_array(kind):
                _check(kind._type_, item, f"{path}[]")
                return
        case _:
            if kind in _KINDS.get(wanted or "", _SCALARS):
                return
    raise LayoutError(
        f"{getattr(kind, '__name__', kind)} cannot hold {path}, "
        f"which is of type {wanted or 'one of several'}"
    )


def _is_array(kind: Any) -> bool:
    return isinstance(kind, type) and issubclass(kind, ctypes.Array)


def _fill(kind: Any, value: Any, path: str) -> Any:
    """Make the value of type `kind` that ctypes stores for a message's value."""
    if is_structure(kind):
        made = kind()
        for name, inner in _fields(kind).items():
            where = f"{path}.{name}".lstrip(".")
            filled = _fill(inner, getattr(value, name), where)
            setattr(made, name, filled)
            if isinstance(filled, int) and getattr(made, name) != filled:  # a bit field
                raise MisfitError(f"{where}: {filled} does not fit")
        return made
    value = raw(value)
    if kind in _SCALARS:
        return _fitting(kind, value, path)
    room = 1 if kind is ctypes.c_char else kind._length_
    if len(value) > room:
        raise MisfitError(f"{path}: {len(value)} bytes or values do not fit into {room}")
    if kind is ctypes.c_char:
        return value or b"\0"
    if kind._type_ is ctypes.c_char:
        return value
    return kind(*(_fill(kind._type_, item, f"{path}[]") for item in value))


def _fitting(kind: Any, value: Any, path: str) -> Any:
    """Check that ctypes, which truncates numbers, stores a value unchanged or rounded."""
    try:
        stored = kind(value).value
    except TypeError as error:
        raise MisfitError(f"{path}: {error}") from error
    is_rounded = isinstance(value, float) and (math.isfinite(stored) or math.isnan(value))
    if stored != value and not is_rounded:
        raise MisfitError(f"{path}: {value} does not fit into a {kind.__name__}")
    return value


def _plain(value: Any, schema: Schema, path: str) -> object:
    if isinstance(value, ctypes.Structure):
        properties = schema["properties"]
        return {
            name: _plain(getattr(value, name), properties[name], f"{path}.{name}".lstrip("."))
            for name in _fields(type(value))
        }
    if isinstance(value, ctypes.Array):
        if "contentEncoding" in schema:
            return bytes(value)
        items = schema.get("prefixItems") or [schema["items"]] * len(value)
        return [_plain(each, item, f"{path}[]") for each, item in zip(value, items, strict=True)]
    return text_of(value, path)


def raw(value: object) -> object:
    """Replace a text or an enumerator by its value in C; leave anything else unchanged."""
    if isinstance(value, Enum):
        value = value.value
    return value.encode() if isinstance(value, str) else value


def text_of(value: object, path: str) -> object:
    """Replace a C string's bytes by its text; leave anything else unchanged."""
    if not isinstance(value, bytes):
        return value
    try:
        return value.partition(b"\0")[0].decode()
    except UnicodeDecodeError as error:
        raise MisfitError(f"{path}: not UTF-8: {error.reason}") from error


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
        """Encode a message; raise :class:`.MisfitError` if a value does not fit."""
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
        """Decode the fields, nested messages as dicts; raise :class:`.MisfitError`."""
        plain: dict[str, Any] = {}
        for (path, _, is_text), value in zip(self._values, self._struct.unpack(data), strict=True):
            *outer, name = path.split(".")
            inner = plain
            for each in outer:
                inner = inner.setdefault(each, {})
            inner[name] = text_of(value, path) if is_text else value
        return plain


MessageLayout: TypeAlias = StructLayout | StructureLayout


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
