"""Messages: immutable, typed values on a whiteboard, and classes for foreign ones.

A message class is checked when it is made, as far as its annotations resolve: a field that is
mutable, or without a type, is an error at the class and not in the first reader. Tools meet slots
whose class they cannot import; :func:`type_from_schema` makes one from the slot's schema.
"""

from __future__ import annotations

import os
import re
import sys
from contextlib import suppress
from functools import lru_cache
from types import new_class
from typing import Annotated, Any, Literal, TypeVar, Union, dataclass_transform
from weakref import WeakValueDictionary

import msgspec

from llfsm.whiteboard.errors import MessageTypeError, wrong_field, wrong_type
from llfsm.whiteboard.schema import MADE_FROM, Schema, describe, excess, limits, summarize


@dataclass_transform(frozen_default=True, field_specifiers=(msgspec.field,))
class _MessageMeta(msgspec.StructMeta):
    """Make frozen, array-like Structs and check their fields; a metaclass, for type checkers."""

    def __new__(
        mcls,
        name: str,
        bases: tuple[type, ...],
        namespace: dict[str, Any],
        *,
        type_name: str | None = None,
        **config: Any,
    ) -> _MessageMeta:
        namespace["__type_name__"] = type_name = type_name or name
        if not type_name.isprintable() or len(type_name.encode()) > 255:
            raise MessageTypeError(f"{name}: {type_name!r} is not a valid type name")
        # An array of values, not a map, is cheaper to decode and easy to write from C; the names
        # are in the slot's schema, once. Unknown fields are forbidden so that a larger message in
        # place of a smaller one is an error instead of being truncated.
        config = {"frozen": True, "array_like": True, "forbid_unknown_fields": True, **config}
        try:
            cls = super().__new__(mcls, name, bases, namespace, **config)
        except TypeError as error:
            if found := re.match(r"Required field '(\w+)' cannot follow", str(error)):
                raise MessageTypeError(
                    f"{name}: field {found[1]!r} has no default, but one before it has: give it a "
                    f"default, or move it up"
                ) from None
            raise
        for field, value in namespace.items():
            if isinstance(value, _PLAIN) and field.islower() and _is_untyped(cls, field):
                raise MessageTypeError(
                    f"{name}: {field!r} is not a field without its type; write {field}: "
                    f"{type(value).__name__} = {value!r}, or call a constant {field.upper()}"
                )
        with suppress(NameError):  # an annotation refers to a later class: the Slot checks again
            describe(cls)
        return cls


_PLAIN = (bool, int, float, str, bytes, tuple, msgspec.Struct)  # what looks like a field's default


def _is_untyped(cls: type, name: str) -> bool:
    if name[0] == "_" or name in cls.__struct_fields__:  # type: ignore[attr-defined]
        return False
    try:
        return name not in cls.__annotations__  # where a ClassVar is, too
    except NameError:  # one of them refers to a later class
        return False


_in_use: WeakValueDictionary[bytes, type[Message]] = WeakValueDictionary()  # by their schemas
_pickled: WeakValueDictionary[tuple[int, int], type[Message]] = WeakValueDictionary()


class Message(msgspec.Struct, metaclass=_MessageMeta):
    """A message on a whiteboard; subclass it and annotate the fields.

    A message is immutable, so readers share it. Fields are ``bool``, ``int`` (64 bit, or a
    narrower ``Annotated`` range), ``float``, ``str``, ``bytes``, ``None``, ``Enum``, ``Literal``,
    other messages, and ``tuple``, ``frozenset`` or unions of these; any other type raises
    :class:`.MessageTypeError`, which names the field. ``type_name`` is the type's name for other
    processes (default: the class's name)::

        class Twist(Message, type_name="geometry_msgs/msg/Twist"):
            linear: Vector3 = Vector3()
            angular: Vector3 = Vector3()

    Messages can be pickled, also those of a class that was made from a definition or a schema:
    where that class is not known, they are of one that is made from its schema.
    """

    def __reduce__(self) -> tuple[Any, ...]:
        """Give what pickle needs: what msgspec has, or the schema of a class without a module."""
        kind: Any = type(self)
        if _is_importable(kind):
            return msgspec.Struct.__reduce__(self)  # type: ignore[return-value]
        of = os.getpid(), id(kind)
        _pickled[of] = kind
        text = msgspec.json.encode(describe(kind))
        return _unpickled, (of, text, msgspec.msgpack.encode(self))


@lru_cache(maxsize=256)
def _is_importable(kind: Any) -> bool:
    found: Any = sys.modules.get(kind.__module__)
    for name in kind.__qualname__.split("."):
        found = getattr(found, name, None)
    return found is kind


def _unpickled(of: tuple[int, int], schema: bytes, data: bytes) -> Message:
    """Make a message of a class that only the process that has pickled it knows."""
    kind = _pickled.get(of) or type_from_schema(msgspec.json.decode(schema))
    return msgspec.msgpack.decode(data, type=kind)


M = TypeVar("M", bound=Message)


def from_buffer(value: object) -> object:
    """Make what a field holds of an array: of numpy, `array` or anything else with a buffer.

    One of bytes becomes bytes, any other the sequence of its numbers, row by row, and one without a
    dimension, as a number of numpy, its number. Raise ``TypeError`` for any other object.
    """
    try:
        view = memoryview(value)  # type: ignore[arg-type]
    except TypeError:
        what = f"Encoding objects of type {type(value).__name__} is unsupported"
        raise TypeError(what) from None
    with view:
        if view.itemsize == 1 and view.format in ("B", "c") and view.shape:
            return view.tobytes()
        try:
            if not view.shape:
                return view.tolist()
            return memoryview(view.tobytes()).cast(view.format).tolist()  # type: ignore[call-overload]
        except (NotImplementedError, ValueError):
            what = f"an array of format {view.format!r} has no numbers of this machine"
            raise TypeError(what) from None


_encode = msgspec.msgpack.Encoder(enc_hook=from_buffer).encode


def plain(message: M) -> M:
    """Return a message whose fields hold what they are declared as: tuples, bytes, numbers.

    Raise what msgspec raises for a value of another type.
    """
    return msgspec.msgpack.decode(_encode(message), type=type(message))


def as_type(slot: str, wanted: type[M], message: object) -> M:
    """Convert a message of another class of the same type: the same name and fields.

    Several parts of a program may have a class of their own for a type, made from a definition of
    ROS or from a schema. Raise :class:`.SlotTypeError` for a message of another type.
    """
    classes: tuple[Any, Any] = wanted, type(message)
    if not _are_same(*classes):
        raise wrong_type(slot, wanted, message)
    try:
        return msgspec.msgpack.decode(_encode(message), type=wanted)
    except (msgspec.MsgspecError, TypeError, ValueError, OverflowError) as error:
        raise wrong_field(slot, wanted, error) from error


@lru_cache(maxsize=64)
def _are_same(wanted: Any, given: Any) -> bool:
    return issubclass(given, Message) and describe(given) == describe(wanted)


def type_from_schema(schema: Schema) -> type[Message]:
    """Make a class for a slot whose Python class is not available, as tools need it.

    Equal schemas have one class as long as it is in use. Its messages are checked by everything in
    the schema but patterns. Raise :class:`.MessageTypeError` unless it is a schema as
    :func:`.describe` makes it, neither too deep nor too large.
    """
    try:
        if too_much := excess(schema):
            raise MessageTypeError(f"not a message's schema: {too_much}")
        text = msgspec.json.encode(schema)
        cls = _in_use.get(text)
        if cls is None:
            cls = _in_use[text] = _made(schema)
        return cls
    except MessageTypeError:
        raise
    except Exception as error:  # another process may write anything as a schema
        raise MessageTypeError(f"not a message's schema: {error}") from error


def _made(schema: Schema) -> type[Message]:
    if not ("title" in schema and isinstance(schema.get("properties"), dict)):
        raise MessageTypeError(f"not a message's schema: {summarize(schema)}")

    fields = [(name, _annotation(s)) for name, s in schema["properties"].items()]
    title = schema["title"]
    return new_class(
        title.rpartition("/")[2],
        (Message,),
        {"type_name": title},
        lambda namespace: namespace.update({"__annotations__": dict(fields), MADE_FROM: schema}),
    )


_SIMPLE = {"boolean": bool, "integer": int, "number": float, "string": str, "null": None}


def _annotation(schema: Schema) -> Any:
    match schema:
        case {"anyOf": options}:
            return Union[tuple(_annotation(o) for o in options)]  # noqa: UP007  from a list
        case {"enum": values}:
            return Literal[tuple(values)]
        case {"type": "object"}:
            return _made(schema)
        case {"type": "array", "prefixItems": items}:
            return tuple[tuple(_annotation(i) for i in items)]  # type: ignore[misc]
        case {"type": "array", "items": item}:
            if schema.get("uniqueItems"):
                return _limited(frozenset[_annotation(item)], schema)  # type: ignore[misc]
            return _limited(tuple[_annotation(item), ...], schema)  # type: ignore[misc]
        case {"type": "string", "contentEncoding": "base64"}:
            return _limited(bytes, schema)
        case {"type": str(kind)} if kind in _SIMPLE:
            return _limited(_SIMPLE[kind], schema)
    raise MessageTypeError(f"not a message's schema: {summarize(schema)}")


def _limited(annotation: Any, schema: Schema) -> Any:
    found = limits(schema)
    return Annotated[annotation, msgspec.Meta(**found)] if found else annotation
