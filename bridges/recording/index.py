"""A file by its index: what is in it, and where, so that no more is in memory than is looked at.

A complete file ends with an index. One that was cut short has none: it is gone through once, from
record to record, without reading what they hold.
"""

from __future__ import annotations

import os
import struct
import zlib
from array import array
from bisect import bisect_left, bisect_right
from collections.abc import Collection, Iterator, Sequence
from functools import lru_cache
from io import BytesIO
from itertools import accumulate
from pathlib import Path
from typing import IO, Final, NamedTuple

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.reader import FOOTER_SIZE, SeekingReader
from mcap.records import Attachment, Channel, Chunk, Metadata, Schema
from mcap.stream_reader import MAGIC_SIZE, get_chunk_data_stream, read_magic

from llfsm.runtime.engine.failure import logger

from .errors import RecordingFileError

__all__ = ["Index", "Record"]

_HELD: Final = 16  # chunks in memory
_HEAD: Final = struct.Struct("<BQ")  # of every record: what it is and how long
_MESSAGE: Final = struct.Struct("<HIQQ")
_CHUNK: Final = struct.Struct("<QQ")
_CHANNEL: Final = struct.Struct("<H")
_FOOTER: Final = struct.Struct("<QQI")


class Record(NamedTuple):
    """A message in the file. Their order is that of time."""

    log_ns: int
    published_ns: int
    sequence: int
    channel: int
    data: bytes


class _Part(NamedTuple):
    """A chunk: where it is, from when to when, and of which channels it has messages."""

    offset: int
    start_ns: int
    end_ns: int
    channels: tuple[int, ...]


class _Found(NamedTuple):
    """A channel's latest message at a moment, which it is for a while."""

    record: Record | None
    chunk: int  # the number of the channel's chunks up to the one that it is in
    is_last: bool  # whether it is that chunk's last one
    from_ns: int
    until_ns: float


class Index:
    """Find messages in a file. `complete` is False for one that was cut short or is damaged.

    Raise :class:`.RecordingFileError` if it cannot be read.
    """

    def __init__(self, path: Path):
        self.path = path
        self.complete = True
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}
        self.metadata: list[Metadata] = []
        self.attachments: list[Attachment] = []
        self._parts: list[_Part] = []
        self._sets: dict[tuple[int, ...], tuple[int, ...]] = {}  # most chunks have the same ones
        self._found: dict[int, _Found] = {}
        self._damaged: set[int] = set()
        self.chunk = lru_cache(maxsize=_HELD)(self._read_chunk)
        try:
            with path.open("rb") as file:
                self._size = os.fstat(file.fileno()).st_size
                if not self._read_summary(file):
                    self.complete = False
                    self._scan(file)
        except OSError as error:
            raise RecordingFileError(f"{path}: cannot be read: {error.strerror}") from error
        # Messages are logged a little out of order: since when does a chunk, or a later one, know?
        self._since = [*accumulate((part.start_ns for part in reversed(self._parts)), min)][::-1]
        self._of: dict[int, array[int]] = {}
        for number, part in enumerate(self._parts):
            for channel in part.channels:
                self._of.setdefault(channel, array("I")).append(number)

    @property
    def chunks(self) -> range:
        """The numbers of its chunks."""
        return range(len(self._parts))

    @property
    def end_ns(self) -> int:
        """When the last message was logged; 0 without any."""
        return max((part.end_ns for part in self._parts), default=0)

    def has(self, number: int, channels: Collection[int]) -> bool:
        """Tell whether a chunk has messages of any of these channels."""
        return not set(channels).isdisjoint(self._parts[number].channels)

    def in_order(self, channels: Collection[int], from_ns: int = 0) -> Iterator[Record]:
        """Return the messages of these channels logged since a moment, in the order of time."""
        waiting: list[Record] = []
        for number, part in enumerate(self._parts):
            if part.end_ns >= from_ns and self.has(number, channels):
                found = self.chunk(number)
                new = (record for channel in channels for record in found.get(channel, ()))
                waiting += [record for record in new if record.log_ns >= from_ns]
                waiting.sort()
            if number + 1 == len(self._parts):
                yield from waiting
            elif waiting:
                ready = bisect_left(waiting, (self._since[number + 1],))
                yield from waiting[:ready]
                del waiting[:ready]

    def latest(self, channel: int, now_ns: int) -> Record | None:
        """Return a channel's last message that was logged at a moment or before."""
        found = self._found.get(channel)
        if found is None or not found.from_ns <= now_ns < found.until_ns:
            self._found[channel] = found = self._find(channel, now_ns, found)
        return found.record

    def _find(self, channel: int, now_ns: int, before: _Found | None) -> _Found:
        chunks: Sequence[int] = self._of.get(channel, array("I"))
        # No chunk from there on has anything of that moment.
        place = bisect_left(chunks, bisect_right(self._since, now_ns))
        until_ns = self._parts[chunks[place]].start_ns if place < len(chunks) else float("inf")
        while place > 0:
            records = self.chunk(chunks[place - 1]).get(channel, [])
            number = bisect_left(records, (now_ns + 1,))
            if number < len(records):
                until_ns = records[number].log_ns
            if number:
                record = records[number - 1]
                return _Found(record, place, number == len(records), record.log_ns, until_ns)
            place -= 1
            if before is not None and before.is_last and before.chunk == place:
                return before._replace(until_ns=until_ns)  # without reading its chunk again
        return _Found(None, 0, False, 0, until_ns)

    def _read_chunk(self, number: int) -> dict[int, list[Record]]:
        """Return a chunk's messages by channel; nothing, and a warning, if it is damaged."""
        found: dict[int, list[Record]] = {}
        try:
            with self.path.open("rb") as file:
                self._walk(self._at(file, self._parts[number].offset, Opcode.CHUNK), found)
        except Exception as error:  # whatever the libraries make of bytes that are none of theirs
            self.complete = False
            if number not in self._damaged:
                self._damaged.add(number)
                logger().warning("%s: a part of it is damaged and left out: %s", self.path, error)
            return {}
        return found

    def _walk(self, chunk: ReadDataStream, found: dict[int, list[Record]]) -> None:
        stream, length = get_chunk_data_stream(Chunk.read(chunk), validate_crc=True)
        data, at = stream.read(length), 0
        while at < length:
            kind, size = _HEAD.unpack_from(data, at)
            at += _HEAD.size
            if kind == Opcode.MESSAGE:
                channel, sequence, log_ns, published_ns = _MESSAGE.unpack_from(data, at)
                message = data[at + _MESSAGE.size : at + size]
                record = Record(log_ns, published_ns, sequence, channel, message)
                found.setdefault(channel, []).append(record)
            elif kind in (Opcode.SCHEMA, Opcode.CHANNEL):
                self._define(kind, ReadDataStream(BytesIO(data[at : at + size])))
            at += size

    def _define(self, kind: int, stream: ReadDataStream) -> None:
        if kind == Opcode.SCHEMA:
            schema = Schema.read(stream)
            self.schemas.setdefault(schema.id, schema)
        else:
            channel = Channel.read(stream)
            self.channels.setdefault(channel.id, channel)

    def _at(self, file: IO[bytes], offset: int, kind: int) -> ReadDataStream:
        """Return what reads a record of that kind, or raise ``ValueError``."""
        file.seek(offset)
        found, length = _HEAD.unpack(file.read(_HEAD.size))
        if found != kind or offset + _HEAD.size + length > self._size:
            raise ValueError(f"no record of kind {kind} at byte {offset}")
        return ReadDataStream(file)

    def _add(self, offset: int, start_ns: int, end_ns: int, channels: Sequence[int]) -> None:
        known = self._sets.setdefault(tuple(channels), tuple(channels))
        self._parts.append(_Part(offset, start_ns, end_ns, known))

    def _read_summary(self, file: IO[bytes]) -> bool:
        """Take what the index at the end says; return False if there is none."""
        try:
            self._check_summary(file)
            file.seek(0)
            summary = SeekingReader(file).get_summary()
            if summary is None:
                return False
            for told in summary.metadata_indexes:
                self.metadata.append(Metadata.read(self._at(file, told.offset, Opcode.METADATA)))
            for index in summary.attachment_indexes:
                stream = self._at(file, index.offset, Opcode.ATTACHMENT)
                self.attachments.append(Attachment.read(stream))
        except OSError:
            raise
        except Exception:  # whatever the library makes of a file that is cut short, or damaged
            self.metadata.clear()
            self.attachments.clear()
            return False
        self.schemas, self.channels = summary.schemas, summary.channels
        for part in summary.chunk_indexes:
            times = part.message_start_time, part.message_end_time
            self._add(part.chunk_start_offset, *times, [*part.message_index_offsets])
        return True

    def _check_summary(self, file: IO[bytes]) -> None:
        file.seek(max(0, self._size - FOOTER_SIZE - MAGIC_SIZE))
        start, _, told = _FOOTER.unpack_from(file.read(FOOTER_SIZE), _HEAD.size)
        if not 0 < start < self._size:
            raise ValueError("there is no index")
        file.seek(start)
        if zlib.crc32(file.read(self._size - MAGIC_SIZE - 4 - start)) != told:
            raise ValueError("the index is damaged")

    def _scan(self, file: IO[bytes]) -> None:
        """Go from record to record, as far as they are whole."""
        try:
            file.seek(0)
            read_magic(ReadDataStream(file))
            self._step_through(file)
        except OSError:
            raise
        except Exception:  # as before: what was found so far is what there is
            pass
        for number, part in enumerate(self._parts):
            last = number + 1 == len(self._parts)  # its own index may be cut
            if last or not self.channels.keys() >= {*part.channels}:
                channels = tuple(self.chunk(number))
                self._parts[number] = part._replace(channels=channels if last else part.channels)

    def _step_through(self, file: IO[bytes]) -> None:
        offset = MAGIC_SIZE
        while True:
            file.seek(offset)
            head = file.read(_HEAD.size)
            if len(head) < _HEAD.size:
                return
            kind, length = _HEAD.unpack(head)
            after = offset + _HEAD.size + length
            if after > self._size or kind == Opcode.DATA_END:
                return
            self._step(kind, offset, ReadDataStream(file))
            offset = after

    def _step(self, kind: int, offset: int, stream: ReadDataStream) -> None:
        if kind == Opcode.CHUNK:
            start_ns, end_ns = _CHUNK.unpack(stream.read(_CHUNK.size))
            self._add(offset, start_ns, end_ns, ())
        elif kind == Opcode.MESSAGE_INDEX and self._parts:
            part = self._parts.pop()
            (channel,) = _CHANNEL.unpack(stream.read(_CHANNEL.size))
            self._add(part.offset, part.start_ns, part.end_ns, (*part.channels, channel))
        elif kind == Opcode.METADATA:
            self.metadata.append(Metadata.read(stream))
        elif kind == Opcode.ATTACHMENT:
            self.attachments.append(Attachment.read(stream))
        elif kind in (Opcode.SCHEMA, Opcode.CHANNEL):
            self._define(kind, stream)
