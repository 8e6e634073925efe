"""A recording, complete or cut short: its slots, its journals, and their history.

Times are those of the whiteboard. Only the parts that are looked at are read, never the whole file.
"""

from __future__ import annotations

from binascii import a2b_base64
from collections.abc import Collection, Iterator, Mapping
from heapq import merge
from operator import attrgetter
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
from mcap.records import Attachment, Channel, Schema

from llfsm.bridges.recording.bags import CDR, BagTopics, open_indexed
from llfsm.bridges.recording.errors import RecordingFileError
from llfsm.bridges.recording.mcap_file import Index, MessageRecord
from llfsm.bridges.recording.writer import (
    ABOUT,
    ARRANGEMENT,
    COUNT,
    EVENTS,
    WRAP,
    WRITER,
    Codec,
    JsonCodec,
)
from llfsm.bridges.ros2.errors import RosTypeError
from llfsm.runtime.journal.entries import FIELDS, Entry
from llfsm.runtime.log import logger
from llfsm.whiteboard import Message, Sample, Slot, WhiteboardError
from llfsm.whiteboard.board import SlotInfo
from llfsm.whiteboard.messages.llfsm import DEFINITIONS, definition_slot
from llfsm.whiteboard.poller import class_of

_BYTES = {"message", "kept"}  # fields of entries
_WRONG_CHANNEL = (LookupError, ValueError, RecursionError, WhiteboardError, RosTypeError)


class RecordedMessage(NamedTuple):
    """A message of a slot, undecoded."""

    stamp_ns: int
    """The time at which it was added."""
    seen_ns: int
    """The time at which it was recorded: later only if it was added before the recording."""
    count: int  # type: ignore[assignment]  # hides tuple.count, as in a Sample
    writer: int
    data: bytes


class RecordedSlot:
    """A slot with recorded messages."""

    def __init__(self, slot: Slot[Any], codec: Codec | None = None):
        self.slot = slot
        self.channels: list[int] = []
        self.attached: list[RecordedMessage] = []  # instead of channels
        self.codec = codec or JsonCodec(slot)

    def sample(self, recorded: RecordedMessage) -> Sample[Message]:
        """Decode a message as it was on the whiteboard; raise ``ValueError`` for an invalid one."""
        message: Message = self.codec.decode(recorded.data)
        return Sample(message, recorded.count, recorded.stamp_ns, recorded.writer)


class RecordedJournal(NamedTuple):
    """The journal of an arrangement.

    `whole` if it begins when the machines do; else what they read before is unknown.
    """

    channel: int
    process: int
    begin_ns: int
    whole: bool
    about: Mapping[str, str]
    """The metadata of the arrangement: machines, plan and folder, as far as they were recorded."""


class TimelineItem(NamedTuple):
    """A message of a slot, or an entry of a journal, undecoded, at its time."""

    now_ns: int
    slot: RecordedSlot | None
    recorded: RecordedMessage | None
    entry: MessageRecord | None


class Recording:
    """Read a recording, or a bag of rosbag2, whose topics are slots as `topics` names them.

    Raise :class:`.RecordingFileError` if the file is not a valid one.
    """

    def __init__(self, path: Path, topics: BagTopics | None = None):
        self.path = path
        self.slots: dict[str, RecordedSlot] = {}
        self.journals: list[RecordedJournal] = []
        self._topics = topics or BagTopics()
        self._file = open_indexed(path, self._topics.keyed, self)
        self._index = Index(self._file)
        about = [each.metadata for each in self._file.metadata if each.name == ABOUT]
        self.about: Mapping[str, str] = about[0] if about else self._about_bag()
        """The recorder's board, host and version."""
        try:
            self._offset_ns = _number(self.about["offset_ns"])
            self._begin_ns = _number(self.about["begin_ns"])
        except (LookupError, ValueError) as error:
            raise self._wrong(f"has invalid metadata: {error}") from error
        # channel -> slot, writer, wraps; None: its sequences are no counts
        self._of: dict[int, tuple[RecordedSlot, int, int | None]] = {}
        self._arrangements = {
            each.metadata.get("session", ""): each.metadata
            for each in self._file.metadata
            if each.name == ARRANGEMENT
        }
        try:
            for attachment in self._file.attachments:
                self._attach(attachment)
            for channel in self._file.channels.values():
                if about:
                    self._add(channel)
                else:
                    self._add_if_known(channel)
        except _WRONG_CHANNEL as error:
            raise self._wrong(f"has an invalid channel or attachment: {error}") from error

    @property
    def complete(self) -> bool:
        """False for a file that was cut short or is damaged: the rest is missing here."""
        return self._file.complete

    @property
    def is_bag(self) -> bool:
        """True for a bag: its messages are those of ROS topics, without events of machines."""
        return any(each.message_encoding == CDR for each in self._file.channels.values())

    @property
    def span_ns(self) -> tuple[int, int]:
        """The times of its beginning and end."""
        end_ns = self._index.end_ns - self._offset_ns
        attached = (each.seen_ns for slot in self.slots.values() for each in slot.attached)
        return self._begin_ns, max(self._begin_ns, end_ns, *attached)

    def messages(
        self, slots: Collection[str] | None = None, from_ns: int = 0
    ) -> Iterator[tuple[RecordedSlot, RecordedMessage]]:
        """Yield the messages of these slots, or of all, in the order in which they were recorded.

        Leave out those recorded before `from_ns`.
        """
        for item in self.timeline(slots, from_ns, events=False):
            if item.recorded is not None and item.slot is not None:
                yield item.slot, item.recorded

    def timeline(
        self, slots: Collection[str] | None = None, from_ns: int = 0, *, events: bool = True
    ) -> Iterator[TimelineItem]:
        """Yield messages and, with `events`, entries of journals, ordered by time."""
        names = self.slots.keys() if slots is None else self.slots.keys() & {*slots}
        channels = {number for name in names for number in self.slots[name].channels}
        if events:
            channels |= {journal.channel for journal in self.journals}
        attached = [
            TimelineItem(recorded.seen_ns, self.slots[name], recorded, None)
            for name in names
            for recorded in self.slots[name].attached
            if recorded.seen_ns >= from_ns
        ]
        attached.sort(key=attrgetter("now_ns"))
        found = self._index.in_order(channels, max(0, from_ns + self._offset_ns))
        yield from merge(attached, map(self._item, found), key=attrgetter("now_ns"))

    def entries(self, journal: RecordedJournal) -> Iterator[Entry]:
        """Yield the entries of a journal, with an entry `Lost` wherever some are missing."""
        after = 0
        for number in self._index.chunks:
            if self._index.has(number, (journal.channel,)):
                for record in self._index.chunk(number).get(journal.channel, ()):
                    if record.sequence != after % WRAP:
                        yield {"event": "Lost"}
                    after = record.sequence + 1
                    yield self.entry(record)

    def message(self, slot: RecordedSlot, recorded: RecordedMessage) -> Message:
        """Decode a message of a slot; raise :class:`.RecordingFileError` for an invalid one."""
        try:
            return slot.sample(recorded).message
        except ValueError as error:
            what = f"message {recorded.count} of {slot.slot.name!r}"
            raise self._wrong(f"{what} is invalid: {error}") from error

    def latest(self, slot: RecordedSlot, now_ns: int) -> RecordedMessage | None:
        """Return the message that a slot held at a moment; None before its first."""
        found = [recorded for recorded in slot.attached if recorded.seen_ns <= now_ns]
        for channel in slot.channels:
            record = self._index.latest(channel, now_ns + self._offset_ns)
            if record is not None:
                found.append(self._recorded(record))
        return max(found, key=attrgetter("count"), default=None)

    def time_of(self, record: MessageRecord) -> int:
        """Return the time at which a message or an entry was recorded."""
        return record.log_ns - self._offset_ns

    def backwards(self, journal: RecordedJournal, now_ns: int) -> Iterator[MessageRecord]:
        """Yield a journal's entries from a moment back to its beginning, undecoded."""
        return self._index.backwards(journal.channel, now_ns + self._offset_ns)

    def history(self, number: int, slots: Collection[str]) -> Iterator[TimelineItem]:
        """Yield the messages of these slots, and all entries, of one of the `chunks`."""
        channels = [n for name in slots for n in self.slots[name].channels]
        channels += [journal.channel for journal in self.journals]
        if self._index.has(number, channels):
            found = self._index.chunk(number)
            for record in sorted(r for channel in channels for r in found.get(channel, ())):
                yield self._item(record)

    @property
    def chunks(self) -> range:
        """The numbers of the file's chunks, in the order in which they were written."""
        return self._index.chunks

    def _add(self, channel: Channel) -> None:
        about = channel.metadata
        if channel.topic == EVENTS:
            begin_ns = _number(about["session"].partition("-")[2])
            made_from = self._arrangements.get(about["session"], {})
            whole = about["whole"] == "yes"
            process = _number(about["writer"])
            journal = RecordedJournal(channel.id, process, begin_ns, whole, made_from)
            self.journals.append(journal)
            return
        schema = self._file.schemas[channel.schema_id]
        if channel.message_encoding == CDR:
            self._add_topic(channel, schema)
            return
        slot = self.slots.get(channel.topic)
        if slot is None:
            plain = msgspec.json.decode(schema.data, type=dict[str, Any])
            capacity = _number(about["capacity"])
            cls = class_of(SlotInfo(channel.topic, schema.name, plain, capacity))
            slot = self.slots[channel.topic] = RecordedSlot(Slot(channel.topic, cls, capacity))
        slot.channels.append(channel.id)
        self._of[channel.id] = slot, _number(about["writer"]), _number(about["wraps"])

    def _about_bag(self) -> Mapping[str, str]:
        """Make metadata for a bag: its time begins with its first message."""
        cdr = [each for each in self._file.channels.values() if each.message_encoding == CDR]
        if not cdr:
            raise self._wrong("is not a recording of llfsm, nor a bag of ROS 2")
        return {"offset_ns": str(self._index.start_ns), "begin_ns": "0"}

    def _add_if_known(self, channel: Channel) -> None:
        """Add a topic of a bag, which may have others of types that are not known here."""
        try:
            if channel.message_encoding != CDR:
                raise ValueError(f"its messages are {channel.message_encoding}, not {CDR}")
            if channel.schema_id not in self._file.schemas:
                raise ValueError("it has no type")
            self._add(channel)
        except _WRONG_CHANNEL as error:
            logger().warning("%s: topic %s is left out: %s", self.path, channel.topic, error)

    def _add_topic(self, channel: Channel, schema: Schema) -> None:
        slot, codec = self._topics.slot(channel, schema)
        known = self.slots.setdefault(slot.name, RecordedSlot(slot, codec))
        if known.slot.fingerprint != slot.fingerprint:
            raise ValueError(f"{slot.name} has messages of two types")
        known.channels.append(channel.id)
        wraps = channel.metadata.get("wraps")
        self._of[channel.id] = known, 0, None if wraps is None else _number(wraps)

    def _attach(self, attachment: Attachment) -> None:
        if not attachment.name.startswith(DEFINITIONS):
            return
        slot = self.slots.get(attachment.name)
        if slot is None:
            slot = RecordedSlot(definition_slot(attachment.name.removeprefix(DEFINITIONS)))
            self.slots[attachment.name] = slot
        plain = msgspec.json.decode(attachment.data, type=dict[str, Any])
        count, writer = _number(plain.pop(COUNT)), _number(plain.pop(WRITER))
        stamp_ns = attachment.create_time - self._offset_ns
        seen_ns = attachment.log_time - self._offset_ns
        data = msgspec.json.encode(plain)
        slot.attached.append(RecordedMessage(stamp_ns, seen_ns, count, writer, data))

    def _recorded(self, record: MessageRecord) -> RecordedMessage:
        _, writer, wraps = self._of[record.channel]
        seen_ns = record.log_ns - self._offset_ns
        return RecordedMessage(
            record.published_ns - self._offset_ns,
            seen_ns,
            seen_ns + 1 if wraps is None else wraps * WRAP + record.sequence,  # both only grow
            writer,
            record.data,
        )

    def _item(self, record: MessageRecord) -> TimelineItem:
        now_ns = record.log_ns - self._offset_ns
        if record.channel not in self._of:
            return TimelineItem(now_ns, None, None, record)
        return TimelineItem(now_ns, self._of[record.channel][0], self._recorded(record), None)

    def entry(self, record: MessageRecord) -> Entry:
        """Decode an entry of a journal; raise :class:`.RecordingFileError` for an invalid one."""
        try:
            entry = msgspec.json.decode(record.data, type=dict[str, Any])
            kind = entry.get("event")
            if kind not in FIELDS or not entry.keys() >= {*FIELDS[kind]}:
                raise ValueError(f"{kind!r} with {', '.join(entry)}")
            for name in _BYTES & entry.keys():
                if entry[name] is not None:
                    entry[name] = a2b_base64(entry[name], strict_mode=True)
        except (ValueError, TypeError) as error:
            raise self._wrong(f"has an invalid event: {error}") from error
        return entry

    def _wrong(self, what: str) -> RecordingFileError:
        return RecordingFileError(f"{self.path}: {what}")


def _number(text: str | int) -> int:
    """Read an integer of 64 bits; raise ``ValueError`` for anything else."""
    number = int(text)
    if not -(1 << 63) <= number < 1 << 63:
        raise ValueError(f"{number} is not an integer of 64 bits")
    return number
