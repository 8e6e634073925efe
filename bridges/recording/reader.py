"""The file of a recording, complete or cut short, as what happened in order of time."""

from __future__ import annotations

from binascii import a2b_base64
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from operator import attrgetter
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
from mcap.records import Channel, Chunk, Footer, Metadata, Schema
from mcap.records import Message as Record
from mcap.stream_reader import StreamReader, breakup_chunk

from llfsm.bridges.view.classes import class_of
from llfsm.runtime.journal import FIELDS, Entry
from llfsm.whiteboard import Message, Sample, Slot
from llfsm.whiteboard.board import SlotInfo

from .errors import RecordingFileError
from .exact import Codec
from .writer import ABOUT, EVENTS

__all__ = ["Recorded", "RecordedSlot", "Recording"]

_WRAP = 1 << 32  # a file counts messages modulo this


class Recorded(NamedTuple):
    """A message of a slot, undecoded."""

    stamp_ns: int
    """When it was added, on the clock of the whiteboard."""
    seen_ns: int
    """When it was recorded: later only if it was there before the recording began."""
    count: int  # type: ignore[assignment]  # hides tuple.count, as in a Sample
    writer: int
    data: bytes


class RecordedSlot:
    """A slot with all its messages, in order of count."""

    def __init__(self, slot: Slot[Any]):
        self.slot = slot
        self.messages: list[Recorded] = []
        self._codec = Codec(slot)

    def sample(self, recorded: Recorded) -> Sample[Message]:
        """Return a message as the whiteboard gave it; raise ``ValueError`` if it is none."""
        message = self._codec.decode(recorded.data)
        return Sample(message, recorded.count, recorded.stamp_ns, recorded.writer)

    @property
    def missed(self) -> int:
        """How many messages came and went without being recorded."""
        if not self.messages:
            return 0
        return self.messages[-1].count - self.messages[0].count + 1 - len(self.messages)


class Recording:
    """Read a recording; raise :class:`.RecordingFileError` if it is none.

    `complete` is False for one that was cut short or is damaged: it has all up to there.
    """

    def __init__(self, path: Path):
        self.path = path
        self.complete = False
        self.slots: dict[str, RecordedSlot] = {}
        self._about: Mapping[str, str] | None = None
        self._offset_ns = self._begin_ns = 0
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, tuple[RecordedSlot | None, int]] = {}
        self._events: list[bytes] = []
        self._end_ns = 0
        try:
            with path.open("rb") as file:
                self._read(StreamReader(file, emit_chunks=True))
        except OSError as error:
            raise self._wrong(f"cannot be read: {error.strerror}") from error
        if self._about is None:
            raise self._wrong("is no recording of llfsm")
        for recorded in self.slots.values():
            recorded.messages.sort(key=attrgetter("count"))

    @property
    def about(self) -> Mapping[str, str]:
        """What the recorder says of itself: board, host, version."""
        return self._about or {}

    @property
    def span_ns(self) -> tuple[int, int]:
        """When it begins and ends, on the clock of the whiteboard."""
        return self._begin_ns, max(self._begin_ns, self._end_ns)

    @cached_property
    def entries(self) -> Sequence[Entry]:
        """The journal of the arrangement that was recorded; empty without one."""
        try:
            return [_entry(data) for data in self._events]
        except ValueError as error:
            raise self._wrong(f"has an event that is none: {error}") from error

    def messages(self) -> Iterator[tuple[RecordedSlot, Recorded]]:
        """Return all messages of all slots, in the order in which they were seen."""
        every = [(slot, each) for slot in self.slots.values() for each in slot.messages]
        every.sort(key=lambda pair: (pair[1].seen_ns, pair[1].stamp_ns))
        return iter(every)

    def _read(self, stream: StreamReader) -> None:
        try:
            for record in stream.records:
                match record:
                    case Chunk():
                        for inner in breakup_chunk(record, validate_crc=True):
                            self._take(inner)
                    case Footer():
                        self.complete = True
                    case _:
                        self._take(record)
        except OSError:
            raise
        except Exception:  # whatever the library makes of a file that is cut short, or damaged
            return

    def _take(self, record: object) -> None:
        match record:
            case Metadata(name=name, metadata=metadata) if name == ABOUT:
                self._offset_ns = int(metadata["offset_ns"])
                self._begin_ns = int(metadata["begin_ns"])
                self._about = metadata
            case Schema(id=number):
                self._schemas[number] = record
            case Channel(id=number) if number not in self._channels:
                self._channels[number] = self._channel(record)
            case Record():
                self._message(record)

    def _channel(self, channel: Channel) -> tuple[RecordedSlot | None, int]:
        if channel.topic == EVENTS:
            return None, 0
        schema = msgspec.json.decode(self._schemas[channel.schema_id].data, type=dict[str, Any])
        capacity, writer = int(channel.metadata["capacity"]), int(channel.metadata["writer"])
        slot = self.slots.get(channel.topic)
        if slot is None:
            name = self._schemas[channel.schema_id].name
            cls = class_of(SlotInfo(channel.topic, name, schema, capacity))
            slot = RecordedSlot(Slot(channel.topic, cls, capacity))
            self.slots[channel.topic] = slot
        return slot, writer

    def _message(self, record: Record) -> None:
        slot, writer = self._channels[record.channel_id]
        self._end_ns = max(self._end_ns, record.log_time - self._offset_ns)
        if slot is None:
            self._events.append(record.data)
            return
        messages = slot.messages
        before = messages[-1].count if messages else 0
        count = record.sequence + before // _WRAP * _WRAP
        if messages and count + _WRAP // 2 < before:
            count += _WRAP
        stamp_ns = record.publish_time - self._offset_ns
        seen_ns = record.log_time - self._offset_ns
        messages.append(Recorded(stamp_ns, seen_ns, count, writer, record.data))

    def _wrong(self, what: str) -> RecordingFileError:
        return RecordingFileError(f"{self.path}: {what}")


def _entry(data: bytes) -> Entry:
    entry = msgspec.json.decode(data, type=dict[str, Any])
    kind = entry.get("event")
    if kind not in FIELDS or not entry.keys() >= {*FIELDS[kind]}:
        raise ValueError(f"{kind!r} with {', '.join(entry)}")
    message = entry.get("message")
    return entry if message is None else {**entry, "message": a2b_base64(message, strict_mode=True)}
