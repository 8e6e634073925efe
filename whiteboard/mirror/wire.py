"""What travels between hosts: MessagePack arrays, each field checked when it is read.

A sender numbers its batches, so that a receiver notices one that was lost and asks for the sender's
messages again. Beats carry the number of the last batch, for the case that it was the lost one.
"""

from __future__ import annotations

from typing import Annotated, Any

import msgspec
from msgspec import Meta

from .merge import Id, Time, Version

__all__ = ["VERSION", "Ask", "Batch", "Beat", "Declaration", "Value", "batches", "decoder"]

VERSION = 2
"""Of this protocol; hosts of another one do not hear each other."""

_CHUNK = 1 << 16  # bytes of messages in a batch; a longer message travels alone

_Name = Annotated[str, Meta(min_length=1, max_length=255)]


class Value(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """A slot's message."""

    slot: _Name
    kind: Annotated[int, Meta(ge=0)]
    """The fingerprint of its type's schema."""
    version: Version
    payload: bytes


class Declaration(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """A slot as its sender has it."""

    slot: _Name
    capacity: Annotated[int, Meta(ge=1, le=1 << 30)]
    schema: dict[str, Any]


class Batch(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """Messages of several slots; a slot is declared when it is sent for the first time."""

    sender: Id
    born: Time
    """When the sender started: with it its numbers start again."""
    number: Id
    sent_ns: Time
    """By the sender's clock, since 1970."""
    values: tuple[Value, ...]
    declarations: tuple[Declaration, ...] = ()


class Beat(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """A sign of life, a few times a second."""

    sender: Id
    born: Time
    number: Id
    """Of its latest batch."""
    sent_ns: Time
    name: Annotated[str, Meta(max_length=255)]


class Ask(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """Ask a host for what is newer than the messages known: the version of each."""

    known: tuple[tuple[_Name, Version], ...]


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
