"""A file's messages by channel and time, with only the chunks in memory that are looked at."""

from __future__ import annotations

from array import array
from bisect import bisect_left, bisect_right
from collections.abc import Collection, Iterator, Sequence
from itertools import accumulate
from typing import NamedTuple

from .mcap_file import McapFile, MessageRecord

__all__ = ["CACHED_CHUNKS", "Index"]

CACHED_CHUNKS = 16
"""How many chunks are kept in memory, unless they exceed `_CACHED_BYTES`."""
_CACHED_BYTES = 64 << 20
_RECORD_BYTES = 256  # that a message takes besides its data

_Chunk = dict[int, list[MessageRecord]]


class _Found(NamedTuple):
    """A channel's latest message at a moment, and how long it stays the latest."""

    record: MessageRecord | None
    chunk: int  # the number of the channel's chunks up to the one that it is in
    is_last: bool  # whether it is the last one in that chunk
    from_ns: int
    until_ns: float


class Index:
    """Find messages in a file, by channel and time."""

    def __init__(self, file: McapFile):
        self._file = file
        self._entries = entries = file.chunks
        self._found: dict[int, _Found] = {}
        self._cached: dict[int, tuple[_Chunk, int]] = {}  # with its bytes; the last one used last
        # Messages are logged a little out of order: since when does a chunk, or a later one, know?
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
        """Return the messages of a chunk, by channel."""
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
        """Return whether a chunk has messages of any of these channels."""
        return not set(channels).isdisjoint(self._entries[number].channels)

    def in_order(self, channels: Collection[int], from_ns: int = 0) -> Iterator[MessageRecord]:
        """Return the messages of these channels logged since a moment, ordered by time."""
        waiting: list[MessageRecord] = []
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
        """Return a channel's messages logged at a moment or before, the last one first."""
        chunks: Sequence[int] = self._of.get(channel, array("I"))
        for place in reversed(range(bisect_left(chunks, bisect_right(self._since, now_ns)))):
            records = self.chunk(chunks[place]).get(channel, [])
            for number in reversed(range(bisect_left(records, (now_ns + 1,)))):
                yield records[number]

    def _find(self, channel: int, now_ns: int, before: _Found | None) -> _Found:
        chunks: Sequence[int] = self._of.get(channel, array("I"))
        # No chunk from there on has anything of that moment.
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
