"""Slots, the named and typed places of a whiteboard, and samples, their messages."""

from __future__ import annotations

import re
from functools import cached_property
from typing import Any, Generic, NamedTuple

import msgspec

from llfsm.whiteboard.errors import MessageTypeError, SlotNameError, SlotTypeError
from llfsm.whiteboard.message import M, Message, from_buffer
from llfsm.whiteboard.schema import Schema, describe, differences, fingerprint

DEFAULT_CAPACITY = 1024
_NAME = re.compile(r"[^\s\x00-\x1f\x7f\ud800-\udfff]{1,255}")


class Slot(Generic[M]):
    """The name of a slot and the type of its messages; define it once, in code that users share.

    Args:
        name: 1 to 255 bytes without white space, by convention ``owner/what``:
            ``turtle1/cmd_vel``.
        type: a :class:`.Message` class; its immutability is checked here if that was impossible
            when the class was made.
        capacity: bytes of the longest encoded message, 1 to 2**30. The first process that uses the
            slot determines it; each writer reserves four times as much.

    Raises:
        SlotNameError: the name or the capacity is invalid.
        MessageTypeError: the type is not a Message class, or has a field that is not immutable.

    """

    def __init__(self, name: str, type: type[M], capacity: int = DEFAULT_CAPACITY) -> None:
        if not isinstance(name, str):
            raise SlotNameError("a slot's name is a text, as Slot('name', Type)")
        if not _NAME.fullmatch(name) or len(name.encode()) > 255:
            raise SlotNameError(
                f"{name!r} is not a valid slot name: use 1 to 255 bytes without white space"
            )
        if not (isinstance(capacity, int) and 1 <= capacity <= 1 << 30):
            raise SlotNameError(
                f"slot {name!r}: the capacity {capacity!r} is not an integer from 1 to 2**30"
            )
        if not (isinstance(type, msgspec.StructMeta) and issubclass(type, Message)):
            given = getattr(type, "__qualname__", repr(type))
            raise MessageTypeError(f"slot {name!r}: {given} is not a Message class")
        self.name = name
        self.type = type
        self.capacity = capacity
        try:
            self.schema: Schema = describe(type)
        except NameError as error:
            raise MessageTypeError(
                f"slot {name!r}: {type.__qualname__} has an annotation that does not resolve: "
                f"{error}"
            ) from error

    def __repr__(self) -> str:
        return f"Slot({self.name!r}, {self.type.__qualname__})"

    @cached_property
    def type_name(self) -> str:
        """The type's name for other processes."""
        return str(self.schema["title"])

    @cached_property
    def fingerprint(self) -> int:
        """A 64-bit hash, equal exactly if two types have the same schema."""
        return fingerprint(self.schema)

    @cached_property
    def encoder(self) -> msgspec.msgpack.Encoder:
        """The encoder of the slot's messages, to MessagePack."""
        return msgspec.msgpack.Encoder(enc_hook=from_buffer)

    @cached_property
    def decoder(self) -> msgspec.msgpack.Decoder[M]:
        """The decoder of the slot's messages, which validates every field."""
        return msgspec.msgpack.Decoder(self.type)

    def clash(self, theirs: Schema) -> SlotTypeError:
        """Make the error for a slot of this name that has another type on the board."""
        try:
            how = "; ".join(differences(theirs, self.schema))
        except Exception:  # another process may write anything as a schema
            how = "its schema is not a message's"
        holds = theirs.get("title", "something else")
        return SlotTypeError(f"slot {self.name!r} holds {holds}, not our {self.type_name}: {how}")

    def __reduce__(self) -> tuple[Any, ...]:
        return (Slot, (self.name, self.type, self.capacity))


class Sample(NamedTuple, Generic[M]):
    """A message as it was added: with its count, stamp and writer."""

    message: M
    count: int  # type: ignore[assignment]  # hides tuple.count, which is useless here
    """The number of this message in its slot; 1 is the first."""
    stamp_ns: int
    """When it was added: nanoseconds of this host's CLOCK_MONOTONIC."""
    writer: int
    """The id of the process that added it."""
