"""Splits the topics of keyed relays: a bag in which each key's messages are a topic of their own.

Whatever reads the bag then finds the slots of the keys as a live bridge makes them.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

from mcap.records import Channel
from mcap.well_known import Profile, SchemaEncoding
from mcap.writer import Writer

from llfsm.runtime.engine.failure import logger
from llfsm.whiteboard import Slot, WhiteboardError

from ..ros2.bridging.bridge_config import RelayConfig
from ..ros2.bridging.key_path import KeyPath
from ..ros2.errors import CdrError, KeyPathError, RosTypeError
from ..ros2.types import RosMessage
from ..ros2.types.definition_text import bundled
from .bag_writer import CDR
from .bags import CAPACITY, SLOT, library_of, temporary_file
from .errors import RecordingFileError
from .index import Index
from .mcap_file import McapFile, MessageRecord

__all__ = ["split_by_key"]


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
