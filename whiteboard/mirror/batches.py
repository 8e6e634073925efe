"""The messages between hosts, and the rule by which those of slots are merged.

**The rule.** Each message of a slot has a version, assigned once, on the host where it was added:

* Its time is the host's clock, or one nanosecond more than the version of the previous message on
  that host's board if that is later. This is a hybrid logical clock (Kulkarni et al., OPODIS 2014)
  with its counter in the nanoseconds. So an add always replaces the message that is on the board
  there, however wrong the clocks are.
* Of two versions, the one with the later time is newer; if the times are equal, the one with the
  larger host id.

A message enters a board only if its version is newer than that of the message there. Versions are
totally ordered and never change. So boards that have received the same messages, in any order and
any number of times, hold the same one, and no board ever goes back.

A version may run ahead of this host's clock by a bound, as in uhlc; one that is further ahead
counts as none. Otherwise, one message with the largest version would close its slot for good:
nothing could replace it, and what builds on it would leave the range of versions.

**The messages** are MessagePack arrays, each field validated when it is decoded. A sender numbers
the batches of each group of slots, so that a receiver notices a lost one and asks for the sender's
messages of that group again. A heartbeat carries the number of the group's last batch, in case that
one was lost. A receiver decodes each message of a batch on its own: one that is malformed does not
take the others with it.
"""

from __future__ import annotations

from typing import Annotated, Any

import msgspec
from msgspec import Meta

VERSION = 4
"""The version of this protocol; hosts with another one only report each other."""

_CHUNK = 1 << 16  # bytes of messages in a batch; a longer message travels alone
_BUFFERS = 4  # of each writer of a slot, as in llfsm_whiteboard.h
_EACH_SLOT = Meta(max_length=4096)  # of a board; checked before memory is taken for the items

Id = Annotated[int, Meta(ge=0, le=(1 << 63) - 1)]
Time = Annotated[int, Meta(ge=0, lt=1 << 62)]  # until the year 2116, and adding never overflows
_RawItems = Annotated[tuple[msgspec.Raw, ...], _EACH_SLOT]
_Name = Annotated[str, Meta(min_length=1, max_length=255)]

encode = msgspec.msgpack.encode
decoder = msgspec.msgpack.Decoder


class Version(msgspec.Struct, frozen=True, order=True, array_like=True, forbid_unknown_fields=True):
    """The time and the host of an add; of two messages, the one with the larger version is newer.

    The order of the fields is the order of versions.
    """

    time: Time
    """Nanoseconds since 1970, of a hybrid logical clock."""
    host: Id


def succeed(before: Version | None, wall_ns: int, host: int) -> Version:
    """Make the version of a message that `host` adds at `wall_ns` on top of another one."""
    return Version(wall_ns if before is None else max(wall_ns, before.time + 1), host)


class Value(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """A slot's message, encoded as on the board, with its version."""

    slot: _Name
    kind: Annotated[int, Meta(ge=0)]
    """The fingerprint of its type's schema."""
    version: Version
    payload: bytes
    """Empty if the slot's name was given up when its latest message had that version."""


class Declaration(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """A slot as its sender has it."""

    slot: _Name
    capacity: Annotated[int, Meta(ge=1, le=1 << 30)]
    schema: dict[str, Any]


class _Head(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """The sender of a batch or a heartbeat, and the time of sending."""

    sender: Id
    born: Time
    """The time at which the sender started; its numbers restart with it."""
    number: Id
    """Of the batch, or of the latest one before a heartbeat."""
    sent_ns: Time
    """By the sender's clock, since 1970."""


class Batch(_Head, frozen=True, array_like=True, forbid_unknown_fields=True):
    """Messages of several slots; a slot is declared when it is sent for the first time."""

    values: tuple[Value, ...]
    declarations: tuple[Declaration, ...] = ()


class ReceivedBatch(_Head, frozen=True, array_like=True, forbid_unknown_fields=True):
    """A batch whose messages and declarations are still encoded."""

    values: _RawItems
    declarations: _RawItems = ()


class Heartbeat(_Head, frozen=True, array_like=True, forbid_unknown_fields=True):
    """Shows a group's readers that a host is alive, a few times a second."""

    name: Annotated[str, Meta(max_length=255)]
    """The host's name in its network."""


class StateQuery(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """Requests a group's messages that are newer than the known ones, given by their versions."""

    known: Annotated[tuple[tuple[_Name, Version], ...], _EACH_SLOT]


def footprint(declaration: Declaration) -> int:
    """Count the bytes of shared memory of a slot that this process makes and adds to."""
    return _BUFFERS * declaration.capacity + len(msgspec.json.encode(declaration.schema))


def divide(values: list[Value]) -> list[list[Value]]:
    """Divide messages into batches of 64 KiB or one message; return at least one batch.

    Small ones come first, so that no large message delays them.
    """
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
