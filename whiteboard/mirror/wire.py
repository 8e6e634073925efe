"""What travels between hosts: MessagePack arrays, each field checked when it is read.

A sender numbers its batches, so that a receiver notices one that was lost and asks for the sender's
messages again. Beats carry the number of the last batch, for the case that it was the lost one.
"""

from __future__ import annotations

from typing import Annotated, Any

import msgspec
from msgspec import Meta

from .merge import Version

__all__ = ["VERSION", "Ask", "Batch", "Beat", "Declaration", "Value", "batches", "decoder"]

VERSION = 1
"""Of this protocol; hosts of another one do not hear each other."""

_CHUNK = 1 << 16  # bytes of messages in a batch; a longer message travels alone

_Id = Annotated[int, Meta(ge=0, le=(1 << 63) - 1)]
_Time = Annotated[int, Meta(ge=0, lt=1 << 62)]  # until the year 2116, and adding never overflows
_Name = Annotated[str, Meta(min_length=1, max_length=255)]


class Value(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """A slot's message."""

    slot: _Name
    kind: Annotated[int, Meta(ge=0)]
    """The fingerprint of its type's schema."""
    time: _Time
    host: _Id
    payload: bytes

    @property
    def version(self) -> Version:
        """When and where it was added."""
        return Version(self.time, self.host)


class Declaration(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """A slot as its sender has it."""

    slot: _Name
    capacity: Annotated[int, Meta(ge=1, le=1 << 30)]
    schema: dict[str, Any]


class Batch(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """Messages of several slots; a slot is declared when it is sent for the first time."""

    sender: _Id
    born: _Time
    """When the sender started: with it its numbers start again."""
    number: _Id
    sent_ns: _Time
    """By the sender's clock, since 1970."""
    values: tuple[Value, ...]
    declarations: tuple[Declaration, ...] = ()


class Beat(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """A sign of life, a few times a second."""

    sender: _Id
    born: _Time
    number: _Id
    """Of its latest batch."""
    sent_ns: _Time
    name: Annotated[str, Meta(max_length=255)]


class Ask(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """Ask a host for what is newer than the messages known: name, time and host of each."""

    known: tuple[tuple[_Name, _Time, _Id], ...]


encode = msgspec.msgpack.encode
decoder = msgspec.msgpack.Decoder


def batches(values: list[Value]) -> list[list[Value]]:
    """Divide messages into what travels together; at least one batch, if only an empty one."""
    if len(values) == 1:
        return [values]
    found: list[list[Value]] = [[]]
    room = _CHUNK
    for value in sorted(values, key=lambda value: len(value.payload)):
        if found[-1] and len(value.payload) > room:
            found.append([])
            room = _CHUNK
        found[-1].append(value)
        room -= len(value.payload)
    return found
