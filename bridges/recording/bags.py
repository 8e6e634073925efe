"""Bags of rosbag2: the slots of their topics, and other bags as MCAP files.

A bag of one MCAP file is read as it is. One of several files, in SQLite (``.db3``), or whose
messages are compressed one by one, is converted into a temporary file first; rosbags reads it.

The file of a recording that ROS's tools take for a bag: MCAP with CDR, profile ``ros2``.

It is what rosbag2's storage writes: a topic has one channel, its schema is the text of the type's
definition and of all that it refers to. So it has no machines' events and no other slots of llfsm's
own, and no slot whose type is not a ROS type.

An MCAP file whose messages are not in chunks, as one whose are: only chunks are indexed.

rosbag2 writes such files with the preset ``fastwrite``.

Splits the topics of keyed relays: a bag in which each key's messages are a topic of their own.

Whatever reads the bag then finds the slots of the keys as a live bridge makes them.
"""

from __future__ import annotations

import re
import shutil
import weakref
from collections.abc import Iterator, Mapping
from pathlib import Path
from tempfile import mkdtemp
from typing import Any, NamedTuple

from mcap.records import Channel, Schema
from mcap.records import Message as McapMessage
from mcap.stream_reader import StreamReader
from mcap.well_known import Profile, SchemaEncoding
from mcap.writer import Writer

from llfsm.bridges.recording.errors import RecordingFileError
from llfsm.bridges.recording.mcap_file import LONGEST_RECORD, Index, McapFile, MessageRecord
from llfsm.bridges.recording.writer import RecordingWriter
from llfsm.bridges.ros2.bridging.bridge_config import BridgeConfig, KeyPath, RelayConfig
from llfsm.bridges.ros2.bridging.service_slots import capacity_for
from llfsm.bridges.ros2.errors import CdrError, KeyPathError, RosNameError, RosTypeError
from llfsm.bridges.ros2.graph import Names
from llfsm.bridges.ros2.types import RosMessage, TypeLibrary
from llfsm.bridges.ros2.types.definition import bundled, unbundled
from llfsm.runtime.log import logger
from llfsm.whiteboard import Message, Sample, Slot, WhiteboardError
from llfsm.whiteboard.own_slots import is_own

CDR = "cdr"


class BagWriter(RecordingWriter):
    """Write a bag; slots of other types are left out, with a warning each."""

    profile = Profile.ROS2

    def __init__(self, path: Path, about: Mapping[str, str], types: TypeLibrary):
        super().__init__(path, about)
        self._types = types
        self._topics: dict[str, int] = {}
        self._found: dict[str, RosMessage[Any] | None] = {}

    def add(self, slot: Slot[Any], sample: Sample[Message], *, new: bool = False) -> None:
        """Write a message of a slot, if its type is a ROS type."""
        if slot.name not in self._found:
            self._found[slot.name] = self._find(slot)
        if self._found[slot.name] is not None:
            super().add(slot, sample, new=new)

    def _find(self, slot: Slot[Any]) -> RosMessage[Any] | None:
        if is_own(slot.name):
            return None
        try:
            Names("bag").full(f"/{slot.name}")
            return self._types.of(slot.type)
        except (RosNameError, RosTypeError) as error:
            logger().warning("slot %s is not recorded: %s", slot.name, error)
            return None

    def _add_channel(self, slot: Slot[Any], writer: int, wraps: int) -> int:
        """Return the topic's channel, whoever writes: in a bag, a topic has one."""
        channel = self._topics.get(slot.name)
        if channel is None:
            of = self._found[slot.name]
            assert of is not None, "a slot that is written has a ROS type"
            self._codecs[slot.name] = of
            text = bundled(self._types.sources(of.name))
            schema = self._schema(of.name, text.encode(), SchemaEncoding.ROS2)
            about = {
                "topic_type_hash": of.type_hash,
                "writer": "0",
                "capacity": str(slot.capacity),
                "wraps": "0",
            }
            channel = self._writer.register_channel(f"/{slot.name}", CDR, schema, about)
            self._topics[slot.name] = channel
        self._channels[slot.name, writer, wraps] = channel
        return channel


# Of a channel's metadata.
CAPACITY = "capacity"
SLOT = "slot"  # if it is not the topic that names it


class BagTopics:
    """Which slot a topic is, and how its messages are decoded.

    A relay of the configuration names the slot of its topic. Without one, it is the topic's name.

    keyed: the keyed relays by topic, for :func:`.split_by_key`.
    """

    def __init__(self, config: BridgeConfig | None = None):
        relays = () if config is None else config.relay
        by_topic = {(relay.topic or relay.slot).lstrip("/"): relay for relay in relays}
        self.keyed = {topic: each for topic, each in by_topic.items() if each.keyed_by}
        self._relays = {topic: each for topic, each in by_topic.items() if not each.keyed_by}
        self._types: dict[int, RosMessage[Any]] = {}

    def slot(self, channel: Channel, schema: Schema) -> tuple[Slot[Any], RosMessage[Any]]:
        """Return a channel's slot and codec; raise ``ValueError`` or :class:`.RosTypeError`."""
        of = self._types.get(schema.id)
        if of is None:
            of = self._types[schema.id] = library_of(schema).message(schema.name)
        topic = channel.topic.lstrip("/")
        relay = self._relays.get(topic)
        capacity = int(channel.metadata.get(CAPACITY, "0")) or capacity_for(of.message)
        if relay is not None:
            topic, capacity = relay.slot, relay.capacity or capacity
        return Slot(channel.metadata.get(SLOT, topic), of.message, capacity), of


def library_of(schema: Schema) -> TypeLibrary:
    """Return the types that a schema defines."""
    texts: Mapping[str, str] = {}
    if schema.encoding == SchemaEncoding.ROS2 and schema.data:
        texts = unbundled(schema.name, schema.data.decode())
    return TypeLibrary(texts=texts)


def as_mcap(path: Path, owner: object) -> Path:
    """Return an MCAP file with a bag's messages: the bag itself, or one that goes with ``owner``.

    Raise :class:`.RecordingFileError`.
    """
    metadata = _metadata(path if path.is_dir() else path.parent)
    if not path.is_dir():
        if path.name in metadata and _has_compressed(metadata, "file|message"):
            raise RecordingFileError(f"{path}: is compressed; name the bag instead: {path.parent}")
        if path.suffix != ".db3":
            return path
    else:
        files = sorted(path.glob("*.mcap"))
        if len(files) == 1 and not _has_compressed(metadata, "message"):
            return files[0]
        if not (path / "metadata.yaml").exists():
            raise RecordingFileError(
                f"{path}: is a folder without metadata.yaml, so it is not a bag; "
                "`ros2 bag reindex` makes one for a bag that was cut short"
            )
    target = temporary_file(owner)
    try:
        with target.open("wb") as file:
            writer = Writer(file)
            writer.start(profile=Profile.ROS2)
            for channel, stamp_ns, data in _messages(path, writer):
                writer.add_message(channel, stamp_ns, data, stamp_ns)
            writer.finish()
    except Exception as error:  # whatever rosbags raises for a bag that is none
        raise RecordingFileError(f"{path}: cannot be read as a bag: {error}") from error
    return target


def _metadata(bag: Path) -> str:
    try:
        return (bag / "metadata.yaml").read_text(errors="replace")
    except OSError:  # of a bag that is not finished
        return ""


def _has_compressed(metadata: str, what: str) -> bool:
    """Return whether a bag compresses each ``file`` as a whole, or each ``message`` in a file."""
    pattern = rf"^\s*compression_mode:\W*(?:{what})\b"
    return re.search(pattern, metadata, re.IGNORECASE | re.MULTILINE) is not None


def temporary_file(owner: object) -> Path:
    """Return a path for an MCAP file that is deleted with ``owner``."""
    folder = mkdtemp(prefix="llfsm-bag-")
    weakref.finalize(owner, shutil.rmtree, folder, ignore_errors=True)
    return Path(folder, "bag.mcap")


def _messages(path: Path, writer: Writer) -> Iterator[tuple[int, int, bytes]]:
    from rosbags.rosbag2 import Reader

    types = TypeLibrary()
    channels: dict[int, int] = {}
    with Reader(path) as bag:
        for connection in bag.connections:
            text = connection.msgdef.data
            if not text or connection.msgdef.format.name != "MSG":
                text = _known_text(types, connection.msgtype)
            schema = writer.register_schema(connection.msgtype, SchemaEncoding.ROS2, text.encode())
            channels[connection.id] = writer.register_channel(connection.topic, CDR, schema)
        for connection, stamp_ns, data in bag.messages():
            yield channels[connection.id], stamp_ns, bytes(data)


def _known_text(types: TypeLibrary, name: str) -> str:
    """Return the definition of a type; empty if it is unknown, which is then the topic's fault."""
    try:
        return bundled(types.sources(name))
    except RosTypeError:
        return ""


def in_chunks(source: McapFile, owner: object) -> McapFile:
    """Return a file with the same messages in chunks, which goes with ``owner``; or the same file.

    As much of a damaged file is in it as can be read.
    """
    if not source.is_unchunked:
        return source
    target = temporary_file(owner)
    with source.path.open("rb") as read, target.open("wb") as written:
        writer = Writer(written)
        writer.start(profile=Profile.ROS2)
        try:
            _copy(StreamReader(read, record_size_limit=LONGEST_RECORD), writer)
        except Exception:  # whatever the library raises for a file that is cut short or damaged
            source.complete = False
        writer.finish()
    found = McapFile(target)
    found.complete = source.complete
    return found


def _copy(source: StreamReader, writer: Writer) -> None:
    schemas = {0: 0}
    channels: dict[int, int] = {}
    for record in source.records:
        match record:
            case Schema():
                schemas[record.id] = writer.register_schema(
                    record.name, record.encoding, record.data
                )
            case Channel():
                channels[record.id] = writer.register_channel(
                    record.topic,
                    record.message_encoding,
                    schemas[record.schema_id],
                    record.metadata,
                )
            case McapMessage():
                writer.add_message(
                    channels[record.channel_id],
                    record.log_time,
                    record.data,
                    record.publish_time,
                    record.sequence,
                )


def split_by_key(source: McapFile, relays: Mapping[str, RelayConfig], owner: object) -> McapFile:
    """Return a file in which the topics of these relays are split; it goes with ``owner``.

    That is the file itself if it has none of the topics. ``relays`` are the keyed ones by topic,
    without a slash. Raise :class:`.RecordingFileError`.
    """
    keyed = {
        channel.id: relays[channel.topic.lstrip("/")]
        for channel in source.channels.values()
        if channel.message_encoding == CDR and channel.topic.lstrip("/") in relays
    }
    if not keyed:
        return source
    target = temporary_file(owner)
    with target.open("wb") as file:
        writer = Writer(file)
        writer.start(profile=Profile.ROS2)
        for each in source.metadata:
            writer.add_metadata(each.name, each.metadata)
        for held in source.attachments:
            writer.add_attachment(
                held.create_time, held.log_time, held.name, held.media_type, held.data
            )
        channels = {
            number: _SplitChannel(source, channel, keyed[number], writer)
            if number in keyed
            else _CopiedChannel(source, channel, writer)
            for number, channel in source.channels.items()
        }
        for record in Index(source).in_order(source.channels):
            channels[record.channel].write(record)
        writer.finish()
    for split in channels.values():
        if isinstance(split, _SplitChannel) and split.left_out:
            logger().warning("%s: %s", source.path, split.left_out)
    return McapFile(target)


class _CopiedChannel:
    def __init__(self, source: McapFile, channel: Channel, writer: Writer) -> None:
        self._writer = writer
        schema = source.schemas.get(channel.schema_id)
        self._channel = writer.register_channel(
            channel.topic,
            channel.message_encoding,
            writer.register_schema(schema.name, schema.encoding, schema.data) if schema else 0,
            channel.metadata,
        )

    def write(self, record: MessageRecord) -> None:
        self._writer.add_message(
            self._channel, record.log_ns, record.data, record.published_ns, record.sequence
        )


class _Lost(NamedTuple):
    """How many messages were left out, and why the first one was."""

    number: int
    why: str


class _SplitChannel:
    def __init__(
        self, source: McapFile, channel: Channel, relay: RelayConfig, writer: Writer
    ) -> None:
        self._topic = channel.topic
        self._relay = relay
        self._writer = writer
        self._channels: dict[str, int] = {}
        self._lost: _Lost | None = None
        schema = source.schemas[channel.schema_id]
        try:
            types = library_of(schema)
            self._of: RosMessage[Any] = types.message(schema.name)
            self._keys = KeyPath(str(relay.keyed_by), self._of.message)
            self._part: RosMessage[Any] = types.of(self._keys.part)
            text = bundled(types.sources(self._part.name))
        except (KeyPathError, RosTypeError) as error:
            raise RecordingFileError(f"{source.path}: topic {channel.topic}: {error}") from error
        self._schema = writer.register_schema(self._part.name, SchemaEncoding.ROS2, text.encode())

    @property
    def left_out(self) -> str:
        if self._lost is None:
            return ""
        return f"{self._lost.number} messages of {self._topic} were left out: {self._lost.why}"

    def write(self, record: MessageRecord) -> None:
        try:
            message = self._of.decode(record.data)
        except CdrError as error:  # the next may be right
            self._leave_out(error)
            return
        for key, part in self._keys.split(message):
            try:
                channel = self._channels.get(key) or self._add_channel(key)
            except (KeyPathError, WhiteboardError) as error:  # the next key may be right
                self._leave_out(error)
            else:
                data = self._part.encode(part)
                self._writer.add_message(channel, record.log_ns, data, record.published_ns)

    def _leave_out(self, why: Exception) -> None:
        lost = self._lost or _Lost(0, str(why))
        self._lost = lost._replace(number=lost.number + 1)

    def _add_channel(self, key: str) -> int:
        if not key:
            raise KeyPathError("a message has an empty key")
        slot = Slot(f"{self._relay.slot}/{key}", self._part.message)
        about = {SLOT: slot.name, CAPACITY: str(self._relay.capacity or 0)}
        number = self._writer.register_channel(self._topic, CDR, self._schema, about)
        self._channels[key] = number
        return number
