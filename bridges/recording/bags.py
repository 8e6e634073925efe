"""Bags of rosbag2: the slots of their topics, and other bags as MCAP files.

A bag of one MCAP file is read as it is. One of several files, in SQLite (``.db3``), or whose
messages are compressed one by one, is converted into a temporary file first; rosbags reads it.
"""

from __future__ import annotations

import re
import shutil
import weakref
from collections.abc import Iterator, Mapping
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

from mcap.records import Channel, Schema
from mcap.well_known import Profile, SchemaEncoding
from mcap.writer import Writer

from llfsm.whiteboard import Slot

from ..ros2.bridging.bridge_config import BridgeConfig
from ..ros2.bridging.capacity import capacity_for
from ..ros2.errors import RosTypeError
from ..ros2.types import RosMessage, TypeLibrary
from ..ros2.types.definition_text import bundled, unbundled
from .bag_writer import CDR
from .errors import RecordingFileError

__all__ = ["CAPACITY", "SLOT", "BagTopics", "as_mcap", "library_of", "temporary_file"]

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
