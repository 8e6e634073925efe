"""Messages laid out as ctypes structures."""

from __future__ import annotations

import ctypes
import math
from enum import Enum
from typing import Any, TypeGuard

from llfsm.whiteboard import Message
from llfsm.whiteboard.schema import Schema

from .errors import LayoutError, MisfitError

__all__ = ["StructureLayout", "is_structure", "raw", "text_of"]

_KINDS: dict[str, tuple[type, ...]] = {
    "boolean": (ctypes.c_bool,),
    "integer": (
        ctypes.c_int8, ctypes.c_int16, ctypes.c_int32, ctypes.c_int64, ctypes.c_longlong,
        ctypes.c_uint8, ctypes.c_uint16, ctypes.c_uint32, ctypes.c_uint64, ctypes.c_ulonglong,
    ),
    "number": (ctypes.c_float, ctypes.c_double),
}  # fmt: skip
_SCALARS = tuple(kind for kinds in _KINDS.values() for kind in kinds)


def is_structure(kind: object) -> TypeGuard[type[ctypes.Structure]]:
    """Return whether `kind` is a class of ctypes structures."""
    return isinstance(kind, type) and issubclass(kind, ctypes.Structure)


class StructureLayout:
    """A layout given by a ctypes structure; fields whose names begin with ``_`` are ignored."""

    def __init__(self, kind: type[ctypes.Structure], schema: Schema) -> None:
        _check(kind, schema, "")
        self.size = ctypes.sizeof(kind)
        self._kind = kind
        self._schema = schema

    def encode(self, message: Message) -> bytes:
        """Return the message's bytes."""
        return bytes(_fill(self._kind, message, ""))

    def decode(self, data: bytes) -> dict[str, object]:
        """Return the fields."""
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
    """Return what ctypes is to store for a message's value."""
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
    """Return the value if ctypes, which truncates numbers, stores it unchanged or rounded."""
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
    """Return what C stores for a text or an enumerator, and anything else unchanged."""
    if isinstance(value, Enum):
        value = value.value
    return value.encode() if isinstance(value, str) else value


def text_of(value: object, path: str) -> object:
    """Return the text in a C string's bytes, and anything else unchanged."""
    if not isinstance(value, bytes):
        return value
    try:
        return value.partition(b"\0")[0].decode()
    except UnicodeDecodeError as error:
        raise MisfitError(f"{path}: not UTF-8: {error.reason}") from error
