"""The file of a recording, under way: what was written is readable whenever the process dies.

Messages are compressed in chunks; a chunk is ended, and handed to the system, after a second at
the latest. Nothing is synced to the disk, so that only a crash of the whole host may take more.

A slot has a channel for each process that writes to it, all of the slot's name: `writer` in its
metadata is the process, the sequence of a message is its count. Times are those of the whiteboard
plus `offset_ns`, which makes them the time of the day; a message that was on the board before was
logged when the recording began, and published when it was added.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any, cast

import msgspec
from mcap.well_known import MessageEncoding, SchemaEncoding
from mcap.writer import Writer

from llfsm.runtime.journal import Entry
from llfsm.whiteboard import Message, Sample, Slot

from .errors import RecordingFileError
from .exact import Codec

__all__ = ["ABOUT", "EVENTS", "STATISTICS", "RecordingWriter"]

EVENTS = "llfsm/events"
"""The channel of what an arrangement's journal says."""
ABOUT = "llfsm/recording"
STATISTICS = "llfsm/statistics"

_FLUSH_NS = 1_000_000_000
_CHUNK = 1 << 20  # bytes, before compression
_EVENT_SCHEMA = {
    "title": "llfsm/Event",
    "type": "object",
    "properties": {"event": {"type": "string"}},
    "required": ["event"],
}


class RecordingWriter:
    """Write a recording; leaving the ``with`` block completes it.

    Raise :class:`.RecordingFileError` if the file cannot be made or written to.
    """

    def __init__(self, path: Path, about: Mapping[str, str]):
        self.path = path
        self._file = _File(path)
        self.begin_ns = time.monotonic_ns()
        self._offset_ns = time.time_ns() - self.begin_ns
        self._flushed_ns = self.begin_ns
        self._writer = Writer(cast("IO[bytes]", self._file), chunk_size=_CHUNK)
        self._schemas: dict[tuple[str, bytes], int] = {}
        self._channels: dict[tuple[str, int], int] = {}
        self._codecs: dict[str, Codec] = {}
        self._seen: dict[str, tuple[int, int, int]] = {}  # first count, last count, number
        self._events: int | None = None
        self._now_ns = self.begin_ns  # of the entry before: not all have a time
        self._writer.start(profile="llfsm")
        times = {"offset_ns": str(self._offset_ns), "begin_ns": str(self.begin_ns)}
        self._writer.add_metadata(ABOUT, {**about, **times})
        self._writer.flush()

    def __enter__(self) -> RecordingWriter:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def size(self) -> int:
        """Bytes in the file so far, without the chunk under way."""
        return self._file.tell()

    def add(self, slot: Slot[Any], sample: Sample[Message], *, new: bool = False) -> None:
        """Write a message of a slot; of a `new` one all since the first are expected."""
        channel = self._channels.get((slot.name, sample.writer))
        if channel is None:
            channel = self._add_channel(slot, sample.writer)
        first, _, number = self._seen.get(slot.name, (1 if new else sample.count, 0, 0))
        self._seen[slot.name] = first, sample.count, number + 1
        published_ns = sample.stamp_ns + self._offset_ns
        self._writer.add_message(
            channel,
            log_time=max(published_ns, self.begin_ns + self._offset_ns),
            data=self._codecs[slot.name].encode(sample.message),
            publish_time=published_ns,
            sequence=sample.count & 0xFFFFFFFF,
        )

    def add_entry(self, entry: Entry) -> None:
        """Write an entry of an arrangement's journal."""
        if self._events is None:
            schema = self._schema("llfsm/Event", msgspec.json.encode(_EVENT_SCHEMA))
            self._events = self._writer.register_channel(EVENTS, MessageEncoding.JSON, schema)
        self._now_ns = entry.get("time_ns", self._now_ns)
        stamp_ns = self._now_ns + self._offset_ns
        self._writer.add_message(self._events, stamp_ns, msgspec.json.encode(entry), stamp_ns)

    def flush(self) -> None:
        """Make sure that what was written is not lost if the process dies."""
        self._writer.flush()

    def flush_if_due(self) -> None:
        """Do that if it was not done for a second."""
        now_ns = time.monotonic_ns()
        if now_ns - self._flushed_ns >= _FLUSH_NS:
            self._flushed_ns = now_ns
            self.flush()

    @property
    def messages(self) -> int:
        """How many messages of slots were written."""
        return sum(number for _, _, number in self._seen.values())

    def missed(self) -> dict[str, int]:
        """Return how many messages of each slot came and went without being seen."""
        return {
            name: last - first + 1 - number for name, (first, last, number) in self._seen.items()
        }

    def close(self) -> None:
        """Complete the file; closing twice is fine."""
        if self._file.closed:
            return
        try:
            counts = {
                name: f"{self._seen[name][2]} recorded, {missed} missed"
                for name, missed in self.missed().items()
            }
            self._writer.flush()
            self._writer.add_metadata(STATISTICS, counts)
            self._writer.finish()
            self._file.flush()
        finally:
            self._file.close()

    def _add_channel(self, slot: Slot[Any], writer: int) -> int:
        self._codecs.setdefault(slot.name, Codec(slot))
        schema = self._schema(slot.type_name, msgspec.json.encode(slot.schema))
        metadata = {"writer": str(writer), "capacity": str(slot.capacity)}
        channel = self._writer.register_channel(slot.name, MessageEncoding.JSON, schema, metadata)
        self._channels[slot.name, writer] = channel
        return channel

    def _schema(self, name: str, data: bytes) -> int:
        known = self._schemas.get((name, data))
        if known is None:
            known = self._writer.register_schema(name, SchemaEncoding.JSONSchema, data)
            self._schemas[name, data] = known
        return known


class _File:
    """What the library writes to: an error names the file."""

    def __init__(self, path: Path):
        self._path = path
        with self._named():
            self._file = path.open("xb")

    def write(self, data: Any, /) -> int:
        with self._named():
            return self._file.write(data)

    def tell(self) -> int:
        return self._file.tell()

    def flush(self) -> None:
        with self._named():
            self._file.flush()

    @property
    def closed(self) -> bool:
        return self._file.closed

    def close(self) -> None:
        with self._named():
            self._file.close()

    @contextmanager
    def _named(self) -> Iterator[None]:
        try:
            yield
        except FileExistsError as error:
            why = f"{self._path} is there already: remove it, or record to another file"
            raise RecordingFileError(why) from error
        except OSError as error:
            why = f"{self._path}: cannot be written: {error.strerror}"
            raise RecordingFileError(why) from error
