"""An MCAP file read through its index, in bounded memory.

An MCAP file is a sequence of records. Messages are in chunks, which are compressed; after each
chunk it says which channels it has, and the file ends with an index of the chunks and their times.
So :class:`McapFile` reads the index only, and a chunk when its messages are asked for. A file that
was cut short has no index: it is stepped through once, by the heads of its records.

:class:`Index` finds messages by channel and time. Chunks overlap in time, as messages are logged a
little out of order. `_since` is what makes this bounded: the first time of a chunk and of all after
it. No later chunk than the last whose `_since` is before a moment knows anything of that moment;
and what is before the next chunk's `_since` is in order, whatever comes.

Memory is bounded here and nowhere else, by the constants below: of a chunk's size, as what is
compressed may claim anything, of its messages, and of the chunks that are kept. What grows with
the file is a few hundred bytes for each of its chunks. Whatever is read is checked: damaged parts
are left out with a warning, and the file counts as incomplete.

This is the one module that uses what the mcap library does not document: it has no way to read a
chunk by its place, or what is left of a damaged file. It assumes

* that :class:`ReadDataStream` reads from any binary file, and every record has a ``read`` that
  takes one, set to the byte after the record's head;
* that a footer has :data:`FOOTER_SIZE` bytes with its head.

A new minor version of mcap may break these; a test for each names the one that no longer holds.
"""

from __future__ import annotations

import os
import struct
import zlib
from array import array
from bisect import bisect_left, bisect_right
from collections.abc import Collection, Iterator, Sequence
from io import BytesIO
from itertools import accumulate
from pathlib import Path
from typing import IO, Final, NamedTuple

import zstandard
from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.reader import FOOTER_SIZE, SeekingReader
from mcap.records import Attachment, Channel, Chunk, Metadata, Schema
from mcap.stream_reader import MAGIC_SIZE, read_magic

from llfsm.bridges.recording.errors import RecordingFileError
from llfsm.errors import nearby_file
from llfsm.runtime.log import logger

LARGEST_CHUNK: Final = 64 << 20
"""Bytes, unpacked. Those that llfsm records have one megabyte, or one message."""
LONGEST_RECORD: Final = LARGEST_CHUNK + (1 << 20)
"""Bytes of a record of any kind; data may resist compression."""
_MOST_MESSAGES: Final = 1 << 18  # of a chunk; each takes a hundred bytes of memory, and more
CACHED_CHUNKS: Final = 16
"""How many chunks are kept in memory, unless they exceed `_CACHED_BYTES`."""
_CACHED_BYTES: Final = 64 << 20
_RECORD_BYTES: Final = 256  # that a message takes besides its data

_HEAD: Final = struct.Struct("<BQ")  # of every record: its kind and its length
_MESSAGE: Final = struct.Struct("<HIQQ")
_CHUNK: Final = struct.Struct("<QQ")
_CHANNEL: Final = struct.Struct("<H")
_FOOTER: Final = struct.Struct("<QQI")


def unpacked(chunk: Chunk) -> bytes:
    """Return the records in a chunk; raise an error of any kind if they are damaged.

    A chunk of a few kilobytes can unpack to gigabytes, and mcap trusts what it says of its size.
    """
    size = chunk.uncompressed_size
    if size > LARGEST_CHUNK:
        raise ValueError(f"it unpacks to {size} bytes, the limit is {LARGEST_CHUNK}")
    if chunk.compression == "zstd":
        data = zstandard.ZstdDecompressor().stream_reader(chunk.data).read(size + 1)
    elif chunk.compression == "lz4":
        data = LZ4FrameDecompressor().decompress(chunk.data, size + 1)
    elif not chunk.compression:
        data = chunk.data
    else:
        raise ValueError(f"its compression {chunk.compression!r} is unknown")
    if len(data) != size:
        raise ValueError(f"it claims to unpack to {size} bytes, but does not")
    if chunk.uncompressed_crc not in (0, zlib.crc32(data)):
        raise ValueError("its checksum is wrong")
    return data


class MessageRecord(NamedTuple):
    """A message in the file, undecoded. Records are ordered by time."""

    log_ns: int
    published_ns: int
    sequence: int
    channel: int
    data: bytes


class ChunkEntry(NamedTuple):
    """A chunk: its place in the file, its first and last time, and its messages' channels."""

    offset: int
    start_ns: int
    end_ns: int
    channels: tuple[int, ...]


class McapFile:
    """The index of a file, and its chunks' messages; it is open only while something is read.

    Raise :class:`.RecordingFileError` if it cannot be read.
    """

    def __init__(self, path: Path):
        self.path = path
        self.complete = True
        """False for a file that was cut short or is damaged."""
        self.is_unchunked = False
        """True if it has messages that are not in chunks, none of which are found here."""
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}
        self.metadata: list[Metadata] = []
        self.attachments: list[Attachment] = []
        self.chunks: list[ChunkEntry] = []
        """In the order in which they were written."""
        self._sets: dict[tuple[int, ...], tuple[int, ...]] = {}  # most chunks have the same ones
        self._damaged: set[int] = set()  # chunks of which that was logged
        try:
            with path.open("rb") as file:
                self._size = os.fstat(file.fileno()).st_size
                if not self._read_summary(file):
                    self.complete = False
                    self._scan(file)
        except OSError as error:
            why = f"{error.strerror}{nearby_file(path)}"
            raise RecordingFileError(f"{path}: cannot be read: {why}") from error

    def messages(self, number: int) -> dict[int, list[MessageRecord]]:
        """Read a chunk's messages by channel; if it is damaged none, and log a warning once."""
        found: dict[int, list[MessageRecord]] = {}
        try:
            with self.path.open("rb") as file:
                self._walk(self._at(file, self.chunks[number].offset, Opcode.CHUNK), found)
        except Exception as error:  # whatever the libraries raise for bytes that are not theirs
            self.complete = False
            if number not in self._damaged:
                self._damaged.add(number)
                logger().warning("%s: a part of it is damaged and left out: %s", self.path, error)
            return {}
        return found

    def _walk(self, chunk: ReadDataStream, found: dict[int, list[MessageRecord]]) -> None:
        data, at, messages = unpacked(Chunk.read(chunk)), 0, 0
        while at < len(data):
            kind, size = _HEAD.unpack_from(data, at)
            at += _HEAD.size
            if kind == Opcode.MESSAGE:
                messages += 1
                if messages > _MOST_MESSAGES:
                    raise ValueError(f"it has more than {_MOST_MESSAGES} messages")
                channel, sequence, log_ns, published_ns = _MESSAGE.unpack_from(data, at)
                message = data[at + _MESSAGE.size : at + size]
                record = MessageRecord(log_ns, published_ns, sequence, channel, message)
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
        """Return a stream at the body of a record of that kind, or raise ``ValueError``."""
        file.seek(offset)
        found, length = _HEAD.unpack(file.read(_HEAD.size))
        if found != kind or offset + _HEAD.size + length > self._size or length > LONGEST_RECORD:
            raise ValueError(f"no record of kind {kind} at byte {offset}")
        return ReadDataStream(BytesIO(file.read(length)))

    def _add(self, offset: int, start_ns: int, end_ns: int, channels: Sequence[int]) -> None:
        known = self._sets.setdefault(tuple(channels), tuple(channels))
        self.chunks.append(ChunkEntry(offset, start_ns, end_ns, known))

    def _read_summary(self, file: IO[bytes]) -> bool:
        """Read the index at the end; return False if there is none."""
        try:
            self._check_summary(file)
            file.seek(0)
            summary = SeekingReader(file, record_size_limit=LONGEST_RECORD).get_summary()
            if summary is None:
                return False
            for entry in summary.metadata_indexes:
                self.metadata.append(Metadata.read(self._at(file, entry.offset, Opcode.METADATA)))
            for index in summary.attachment_indexes:
                stream = self._at(file, index.offset, Opcode.ATTACHMENT)
                self.attachments.append(Attachment.read(stream))
        except OSError:
            raise
        except Exception:  # whatever the library raises for a file that is cut short or damaged
            self.metadata.clear()
            self.attachments.clear()
            return False
        self.schemas, self.channels = summary.schemas, summary.channels
        for chunk in summary.chunk_indexes:
            times = chunk.message_start_time, chunk.message_end_time
            self._add(chunk.chunk_start_offset, *times, [*chunk.message_index_offsets])
        counted = summary.statistics.message_count if summary.statistics else len(self.channels)
        self.is_unchunked = bool(counted) and not self.chunks
        return True

    def _check_summary(self, file: IO[bytes]) -> None:
        file.seek(max(0, self._size - FOOTER_SIZE - MAGIC_SIZE))
        start, _, checksum = _FOOTER.unpack_from(file.read(FOOTER_SIZE), _HEAD.size)
        if not 0 < start < self._size:
            raise ValueError("there is no index")
        file.seek(start)
        if zlib.crc32(file.read(self._size - MAGIC_SIZE - 4 - start)) != checksum:
            raise ValueError("the index is damaged")

    def _scan(self, file: IO[bytes]) -> None:
        """Find the chunks of a file without an index, and what they define.

        The records after a chunk say which channels it has. A channel that none has defined so far
        is defined in a chunk, so that is read.
        """
        try:
            file.seek(0)
            read_magic(ReadDataStream(file))
            self._step_through(file)
        except OSError:
            raise
        except Exception:  # of a damaged record: what was found so far is all there is
            pass
        unread: list[int] = []  # chunks
        for number, chunk in enumerate(self.chunks):
            last = number + 1 == len(self.chunks)
            if not last and self._has_defined(chunk.channels):
                unread.append(number)
                continue
            channels = tuple(self.messages(number))
            if last:  # its own index may be cut
                self.chunks[number] = chunk._replace(channels=channels)
            # A channel may be defined at the end of a chunk, and have its first message in a later.
            while unread and not self._has_defined(self.chunks[number].channels):
                self.messages(unread.pop())

    def _has_defined(self, channels: Sequence[int]) -> bool:
        return self.channels.keys() >= {*channels}

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
            body = file.read(min(length, LONGEST_RECORD))
            self._step(kind, offset, ReadDataStream(BytesIO(body)))
            offset = after

    def _step(self, kind: int, offset: int, stream: ReadDataStream) -> None:
        if kind == Opcode.CHUNK:
            start_ns, end_ns = _CHUNK.unpack(stream.read(_CHUNK.size))
            self._add(offset, start_ns, end_ns, ())
        elif kind == Opcode.MESSAGE_INDEX and self.chunks:
            chunk = self.chunks.pop()
            (channel,) = _CHANNEL.unpack(stream.read(_CHANNEL.size))
            self._add(chunk.offset, chunk.start_ns, chunk.end_ns, (*chunk.channels, channel))
        elif kind == Opcode.MESSAGE:
            self.is_unchunked = True
        elif kind == Opcode.METADATA:
            self.metadata.append(Metadata.read(stream))
        elif kind == Opcode.ATTACHMENT:
            self.attachments.append(Attachment.read(stream))
        elif kind in (Opcode.SCHEMA, Opcode.CHANNEL):
            self._define(kind, stream)


_Chunk = dict[int, list[MessageRecord]]


class _Found(NamedTuple):
    """A channel's latest message from one moment to another."""

    record: MessageRecord | None
    chunk: int  # the number of the channel's chunks up to the one that it is in
    is_last: bool  # whether it is the last one in that chunk
    from_ns: int
    until_ns: float


class Index:
    """Find messages in a file, by channel and time in ns as logged."""

    def __init__(self, file: McapFile):
        self._file = file
        self._entries = entries = file.chunks
        self._found: dict[int, _Found] = {}
        self._cached: dict[int, tuple[_Chunk, int]] = {}  # with its bytes; the last one used last
        self._since = [*accumulate((entry.start_ns for entry in reversed(entries)), min)][::-1]
        self._of: dict[int, array[int]] = {}
        for number, entry in enumerate(entries):
            for channel in entry.channels:
                self._of.setdefault(channel, array("I")).append(number)

    @property
    def chunks(self) -> range:
        """The numbers of its chunks."""
        return range(len(self._entries))

    @property
    def start_ns(self) -> int:
        """When the first message was logged; 0 without any."""
        return self._since[0] if self._since else 0

    @property
    def end_ns(self) -> int:
        """When the last message was logged; 0 without any."""
        return max((entry.end_ns for entry in self._entries), default=0)

    def chunk(self, number: int) -> _Chunk:
        """Return the messages of a chunk, by channel; read it if it is not in memory."""
        cached = self._cached.pop(number, None)
        if cached is None:
            found = self._file.messages(number)
            sizes = (_RECORD_BYTES + len(each.data) for part in found.values() for each in part)
            cached = found, sum(sizes)
        self._cached[number] = cached
        while len(self._cached) > 1 and (
            len(self._cached) > CACHED_CHUNKS
            or sum(size for _, size in self._cached.values()) > _CACHED_BYTES
        ):
            del self._cached[next(iter(self._cached))]
        return cached[0]

    def has(self, number: int, channels: Collection[int]) -> bool:
        """Check in the index that a chunk has messages of any of these channels."""
        return not set(channels).isdisjoint(self._entries[number].channels)

    def in_order(self, channels: Collection[int], from_ns: int = 0) -> Iterator[MessageRecord]:
        """Yield the messages of these channels logged since a moment, ordered by time."""
        waiting: list[MessageRecord] = []  # until no later chunk can have an earlier one
        for number, entry in enumerate(self._entries):
            if entry.end_ns >= from_ns and self.has(number, channels):
                found = self.chunk(number)
                new = (record for channel in channels for record in found.get(channel, ()))
                waiting += [record for record in new if record.log_ns >= from_ns]
                waiting.sort()
            if number + 1 == len(self._entries):
                yield from waiting
            elif waiting:
                ready = bisect_left(waiting, (self._since[number + 1],))
                yield from waiting[:ready]
                del waiting[:ready]

    def latest(self, channel: int, now_ns: int) -> MessageRecord | None:
        """Return a channel's last message that was logged at a moment or before."""
        found = self._found.get(channel)
        if found is None or not found.from_ns <= now_ns < found.until_ns:
            self._found[channel] = found = self._find(channel, now_ns, found)
        return found.record

    def backwards(self, channel: int, now_ns: int) -> Iterator[MessageRecord]:
        """Yield a channel's messages logged at a moment or before, the last one first."""
        chunks: Sequence[int] = self._of.get(channel, array("I"))
        for place in reversed(range(bisect_left(chunks, bisect_right(self._since, now_ns)))):
            records = self.chunk(chunks[place]).get(channel, [])
            for number in reversed(range(bisect_left(records, (now_ns + 1,)))):
                yield records[number]

    def _find(self, channel: int, now_ns: int, before: _Found | None) -> _Found:
        chunks: Sequence[int] = self._of.get(channel, array("I"))
        # No chunk from that place on has anything of the moment.
        place = bisect_left(chunks, bisect_right(self._since, now_ns))
        until_ns = self._entries[chunks[place]].start_ns if place < len(chunks) else float("inf")
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
