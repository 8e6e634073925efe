"""The file of a recording in progress: what was written can be read whenever the process ends.

Messages are compressed in chunks; a chunk is closed and handed to the system after at most one
second. Nothing is synced to the disk, so only a crash of the whole host can lose more.

A slot has a channel for each process that writes to it, with the slot's name as topic: `writer` in
its metadata is the process, the sequence of a message is its count modulo 2**32, and `wraps` is the
number of wrap-arounds. Times are those of the whiteboard plus `offset_ns`, which makes them
wall-clock times. A message that was on the board before the recording has the beginning of the
recording as log time, and the time at which it was added as publish time.

An arrangement's journal is a channel, too: each of its entries is a JSON object
(:mod:`llfsm.runtime.journal.entries` has their kinds), at the machines' time plus how far that is
behind the host's. Sequences show where entries are missing; a gap that is known is an entry `Lost`.
Arrangements and machine definitions are metadata and attachments, which MCAP tools list. The
metadata of an arrangement are written when all its first machines are known, at its first event.

Messages are JSON that any tool can read, and come back without loss. The object follows the slot's
schema: `bytes` are base64, integers keep all their digits. JSON has no number for NaN and the
infinities, which are written as null, and does not distinguish the members of some unions. An
object that would be ambiguous has an additional member `$msgpack`: the message as on the
whiteboard, MessagePack in base64. No field's name can begin with a `$`.
"""

from __future__ import annotations

import os
import time
from binascii import a2b_base64, b2a_base64
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from io import BufferedWriter, FileIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import msgspec
from mcap.well_known import MessageEncoding, SchemaEncoding
from mcap.writer import Writer

from llfsm.bridges.recording.errors import RecordingFileError
from llfsm.runtime.journal.entries import Entry
from llfsm.whiteboard import Message, Sample, Slot
from llfsm.whiteboard.closing import ClosedOnExit
from llfsm.whiteboard.messages.llfsm import MachineDefinition
from llfsm.whiteboard.schema import from_plain, to_plain

if TYPE_CHECKING:
    from llfsm.bridges.ros2.types import RosMessage

EVENTS = "llfsm/events"
"""The topic of the journals of arrangements; each journal has a channel."""
ABOUT = "llfsm/recording"
ARRANGEMENT = "llfsm/arrangement"
STATISTICS = "llfsm/statistics"
EXACT = "$msgpack"
COUNT, WRITER = "$count", "$writer"
"""Members of an attachment besides a definition's fields."""
WRAP = 1 << 32
"""Sequences in a file are counts modulo this."""
_NEVER_NS = 1 << 63  # MCAP has 64 bits for a time, other tools read them as signed
_FLUSH_NS = 1_000_000_000
_CHUNK = 1 << 20  # bytes, before compression
_NEW = os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0)  # as on Windows
_EVENT_SCHEMA = {
    "title": "llfsm/Event",
    "type": "object",
    "properties": {"event": {"type": "string"}},
    "required": ["event"],
}


class JsonCodec:
    """Encodes and decodes the messages of one slot as JSON."""

    def __init__(self, slot: Slot[Any]):
        self.slot = slot
        self._ambiguous = b"anyOf" in msgspec.json.encode(slot.schema)

    def encode(self, message: Message) -> bytes:
        """Encode a message as a JSON object, with its exact form if that would be ambiguous."""
        plain = to_plain(message)
        text = msgspec.json.encode(plain)
        if (self._ambiguous or b"null" in text) and not self._is_exact(plain, text, message):
            payload = self.slot.encoder.encode(message)
            plain[EXACT] = b2a_base64(payload, newline=False).decode()
            text = msgspec.json.encode(plain)
        return text

    def decode(self, text: bytes) -> Message:
        """Decode a message; raise ``ValueError`` if the text is not a message of this slot."""
        plain = msgspec.json.decode(text, type=dict[str, Any])
        if EXACT in plain:
            message = self.slot.decoder.decode(a2b_base64(plain[EXACT]))
        else:
            message = msgspec.convert(from_plain(plain, self.slot.schema), self.slot.type)
        assert isinstance(message, Message)
        return message

    def _is_exact(self, plain: Any, text: bytes, message: Message) -> bool:
        try:
            back = self.decode(text)
        except ValueError:  # for example null where a number is required
            return False
        return back == message and to_plain(back) == plain


Codec: TypeAlias = "JsonCodec | RosMessage[Any]"
"""Encodes and decodes the messages of one slot; raises ``ValueError`` for bytes that are none."""


@dataclass
class _WrittenJournal:
    """A journal that is being written: its latest time, by the host's clock, and its entries."""

    now_ns: int
    behind_ns: int = 0  # how far the machines' clock is behind
    number: int = 0


class RecordingWriter(ClosedOnExit):
    """Write a recording; leaving the ``with`` block completes the file.

    Raise :class:`.RecordingFileError` if the file cannot be made or written to.
    """

    profile = "llfsm"

    def __init__(self, path: Path, about: Mapping[str, str]):
        self.path = path
        self._file = _File(path)
        self.begin_ns = time.monotonic_ns()
        self._offset_ns = time.time_ns() - self.begin_ns
        self._flushed_ns = self.begin_ns
        self._writer = Writer(self._file, chunk_size=_CHUNK)
        self._schemas: dict[tuple[str, bytes], int] = {}
        self._channels: dict[tuple[str, int, int], int] = {}
        self._codecs: dict[str, Codec] = {}
        self._seen: dict[str, tuple[int, int, int]] = {}  # first count, last count, number
        self._journals: dict[int, _WrittenJournal] = {}
        self.events = 0
        """The number of events of machines that were written."""
        self.lost = 0
        """The number of gaps where events were lost."""
        self._writer.start(profile=self.profile)
        times = {"offset_ns": str(self._offset_ns), "begin_ns": str(self.begin_ns)}
        self.add_metadata(ABOUT, {**about, **times})

    @property
    def size(self) -> int:
        """The bytes in the file so far, without the open chunk."""
        return self._file.tell()

    def add(self, slot: Slot[Any], sample: Sample[Message], *, new: bool = False) -> None:
        """Write a message of a slot; of a `new` one, messages are missed from the first on."""
        last, number, missed = self._seen.get(slot.name, (0 if new else sample.count - 1, 0, 0))
        if sample.count <= last:  # the name was given up, and is that of another slot now
            last = 0
        missed += sample.count - last - 1
        self._seen[slot.name] = sample.count, number + 1, missed
        published_ns = sample.stamp_ns + self._offset_ns
        logged_ns = max(published_ns, self.begin_ns + self._offset_ns)
        if slot.type is MachineDefinition:
            self._attach(slot, sample, published_ns, logged_ns)
            return
        wraps, sequence = divmod(sample.count, WRAP)
        channel = self._channels.get((slot.name, sample.writer, wraps))
        if channel is None:
            channel = self._add_channel(slot, sample.writer, wraps)
        data = self._codecs[slot.name].encode(sample.message)
        self._writer.add_message(channel, logged_ns, data, published_ns, sequence)

    def add_journal(self, about: Mapping[str, str]) -> int:
        """Begin the journal of an arrangement, and return its number for `add_entry`."""
        schema = self._schema("llfsm/Event", msgspec.json.encode(_EVENT_SCHEMA))
        channel = self._writer.register_channel(EVENTS, MessageEncoding.JSON, schema, {**about})
        self._journals[channel] = _WrittenJournal(self.begin_ns)
        return channel

    def add_entry(self, journal: int, entry: Entry) -> None:
        """Write an entry of a journal; raise ``ValueError`` for a time that no file can have."""
        written = self._journals[journal]
        behind_ns, now_ns = entry.get("behind_ns", written.behind_ns), written.now_ns
        if "time_ns" in entry:
            now_ns = entry["time_ns"] + behind_ns
        stamp_ns, number = now_ns + self._offset_ns, written.number
        if not 0 <= stamp_ns < _NEVER_NS:
            raise ValueError(f"an entry of a journal has the time {stamp_ns} ns")
        written.behind_ns, written.now_ns = behind_ns, now_ns
        written.number += 1
        data = msgspec.json.encode(entry)
        self._writer.add_message(journal, stamp_ns, data, stamp_ns, number & (WRAP - 1))
        self.events += "reads" in entry

    def add_metadata(self, name: str, about: Mapping[str, str]) -> None:
        """Write metadata, and hand it to the system at once."""
        self._writer.add_metadata(name, {**about})
        self._file.flush()

    def flush(self) -> None:
        """Close the chunk: what was written is not lost if the process dies."""
        self._writer.flush()

    def flush_if_due(self) -> None:
        """Flush if the last flush was a second ago."""
        now_ns = time.monotonic_ns()
        if now_ns - self._flushed_ns >= _FLUSH_NS:
            self._flushed_ns = now_ns
            self.flush()

    @property
    def messages(self) -> int:
        """The number of messages of slots that were written."""
        return sum(number for _, number, _ in self._seen.values())

    def missed(self) -> dict[str, int]:
        """Count the messages of each slot that were replaced before they were read."""
        return {name: missed for name, (_, _, missed) in self._seen.items()}

    def close(self) -> None:
        """Complete the file; closing twice is fine."""
        if self._file.closed:
            return
        try:
            counts = {
                name: f"{self._seen[name][1]} recorded, {missed} missed"
                for name, missed in self.missed().items()
            }
            if self._journals:
                counts[EVENTS] = f"{self.events} recorded, {self.lost} gaps"
            self._writer.flush()
            self._writer.add_metadata(STATISTICS, counts)
            self._writer.finish()
            self._file.flush()
        finally:
            self._file.close()

    def _attach(
        self, slot: Slot[Any], sample: Sample[Message], published_ns: int, logged_ns: int
    ) -> None:
        codec = JsonCodec(slot)
        plain = msgspec.json.decode(codec.encode(sample.message))
        data = msgspec.json.encode({**plain, COUNT: sample.count, WRITER: sample.writer})
        self._writer.add_attachment(published_ns, logged_ns, slot.name, "application/json", data)
        self._file.flush()

    def _add_channel(self, slot: Slot[Any], writer: int, wraps: int) -> int:
        self._codecs.setdefault(slot.name, JsonCodec(slot))
        schema = self._schema(slot.type_name, msgspec.json.encode(slot.schema))
        metadata = {"writer": str(writer), "capacity": str(slot.capacity), "wraps": str(wraps)}
        channel = self._writer.register_channel(slot.name, MessageEncoding.JSON, schema, metadata)
        self._channels[slot.name, writer, wraps] = channel
        return channel

    def _schema(self, name: str, data: bytes, encoding: str = SchemaEncoding.JSONSchema) -> int:
        known = self._schemas.get((name, data))
        if known is None:
            known = self._writer.register_schema(name, encoding, data)
            self._schemas[name, data] = known
        return known


class _File(BufferedWriter):
    """The file that the library writes to; errors name the file.

    It is private to its user, as the whiteboard is that is recorded.
    """

    def __init__(self, path: Path):
        self._path = path
        with self._named():
            super().__init__(FileIO(os.open(path, _NEW, 0o600), "wb"))

    def write(self, data: Any, /) -> int:
        with self._named():
            return super().write(data)

    def flush(self) -> None:
        with self._named():
            super().flush()

    def close(self) -> None:
        with self._named():
            super().close()

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


class JournalWriter:
    """Write the journal of one arrangement, which process `pid` began at the time `session`.

    `whole` is a journal that begins before its machines have done anything.
    """

    def __init__(self, writer: RecordingWriter, *, pid: int, session: int, whole: bool):
        self._writer = writer
        self._about = {
            "session": f"{pid}-{session}",
            "writer": str(pid),
            "whole": "yes" if whole else "no",
        }
        self._channel = writer.add_journal(self._about)
        self._made: Mapping[str, str] = {}
        self._is_described = False
        self.machines: list[str] = []
        """The names of the machines that were loaded at the beginning."""

    def add(self, entry: Entry) -> None:
        """Write an entry; those that describe the arrangement become its metadata."""
        kind: Any = entry["event"]
        if kind == "Plan":
            self._made = {
                "plan": msgspec.json.encode(entry["plan"]).decode(),
                "folder": str(entry["folder"]),
            }
            return
        if kind == "Restored":
            self.describe()  # what it loads is inside of the machines that were loaded before
        elif kind == "Loaded" and not self._is_described:
            self.machines.append(str(entry["machine"]))
        elif "reads" in entry:
            self.describe()
        self._writer.add_entry(self._channel, entry)

    def add_lost(self) -> None:
        """Mark a gap: entries are missing here."""
        self._writer.lost += 1
        self._writer.add_entry(self._channel, {"event": "Lost"})

    def describe(self) -> bool:
        """Write the metadata of the arrangement once; return True if they were written before."""
        before, self._is_described = self._is_described, True
        if not before:
            about = {**self._about, "machines": ", ".join(self.machines), **self._made}
            self._writer.add_metadata(ARRANGEMENT, about)
        return before
