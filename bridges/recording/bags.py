"""Bags of rosbag2: written as ROS's tools expect them, and read as recordings.

A bag is written as rosbag2's storage writes it: MCAP of profile ``ros2``, messages in CDR, one
channel a topic, whose schema is the text of its type's definition and of all that it refers to. So
it has no machines' events, no other slots of llfsm's own, and no slot without a ROS type.

A recording is read through the index of one MCAP file, which has its messages in chunks
(:mod:`.mcap_file`). A bag may be something else: several files, SQLite (``.db3``), compressed file
by file or message by message, or MCAP without chunks, as of the preset ``fastwrite``. And the topic
of a keyed relay has messages for many slots: each key is to have a channel, as behind a live bridge
each has a slot. Such a bag is converted when it is opened, in one pass: its messages are read one
by one, those of keyed topics split, and written to a temporary file that is deleted with the
recording. In memory are a chunk of each file, and what :class:`.Index` keeps.

Temporary files are bounded: a file may unpack to a hundred times its size. Their folder is removed
when its process ends, and that of a process which was killed by the next one that makes one.
"""

from __future__ import annotations

import os
import re
import shutil
import weakref
from collections.abc import Iterator, Mapping
from contextlib import closing
from pathlib import Path
from tempfile import gettempdir, mkdtemp
from typing import Any, TypeAlias
from urllib.parse import quote

from mcap.records import Channel, Schema
from mcap.records import Message as McapMessage
from mcap.stream_reader import StreamReader
from mcap.well_known import Profile, SchemaEncoding
from mcap.writer import Writer

from llfsm.bridges.recording.errors import RecordingFileError
from llfsm.bridges.recording.mcap_file import (
    LARGEST_CHUNK,
    LONGEST_RECORD,
    Index,
    McapFile,
    MessageRecord,
)
from llfsm.bridges.recording.writer import RecordingWriter
from llfsm.bridges.ros2.bridging.bridge_config import BridgeConfig, KeyPath, RelayConfig
from llfsm.bridges.ros2.bridging.service_slots import capacity_for
from llfsm.bridges.ros2.errors import CdrError, KeyPathError, RosNameError, RosTypeError
from llfsm.bridges.ros2.graph import Names
from llfsm.bridges.ros2.types import RosMessage, TypeLibrary
from llfsm.bridges.ros2.types.definition import bundled, unbundled
from llfsm.runtime.log import logger
from llfsm.whiteboard import Message, Sample, Slot, WhiteboardError
from llfsm.whiteboard.liveness import lives, this_process
from llfsm.whiteboard.slot_names import is_own

CDR = "cdr"
_TEMPORARY = "llfsm-bag-"
_MOST_TIMES = 100  # a bag of one camera's black picture is packed by less
_LEAST_UNPACKED = 1 << 28  # bytes that any file may unpack to
_WINDOW = 1 << 27  # bytes of what was unpacked that zstd looks back at: its own limit


class BagWriter(RecordingWriter):
    """Write a bag; leave out slots that have no ROS type, with a warning for each."""

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
        """Return the topic's channel, whoever writes: a topic of a bag has only one."""
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
    """The slots of a bag's topics, and how their messages are decoded.

    A relay of the configuration names the slot of its topic. Without one, it is the topic's name.

    keyed: the keyed relays by topic, without a slash, for :func:`open_indexed`.
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
    """Read the types that a schema defines."""
    texts: Mapping[str, str] = {}
    if schema.encoding == SchemaEncoding.ROS2 and schema.data:
        texts = unbundled(schema.name, schema.data.decode())
    return TypeLibrary(texts=texts)


def open_indexed(path: Path, keyed: Mapping[str, RelayConfig], owner: object) -> McapFile:
    """Open a recording or a bag as one MCAP file with chunks, and a channel for each key.

    `keyed` are the keyed relays by topic, without a slash. A file that must be made for this is
    deleted with `owner`. Of a damaged bag there is as much as can be read. Raise
    :class:`.RecordingFileError`.
    """
    file = _single_file(path)
    if file is None:
        folder = _temporary(owner)
        return _converted(path, _by_rosbags(path, folder), keyed, folder)
    source = McapFile(file)
    if source.is_unchunked:
        items = _unchunked(source)
    elif any(_relay_of(each, keyed) is not None for each in source.channels.values()):
        items = _chunked(source)
    else:
        return source
    return _converted(file, items, keyed, _temporary(owner), source)


def _single_file(path: Path) -> Path | None:
    """Return the MCAP file that holds a bag; None for a bag that only rosbags reads."""
    metadata = _metadata(path if path.is_dir() else path.parent)
    if not path.is_dir():
        if path.name in metadata and _has_compressed(metadata, "file|message"):
            raise RecordingFileError(f"{path}: is compressed; name the bag instead: {path.parent}")
        return None if path.suffix == ".db3" else path
    files = sorted(path.glob("*.mcap"))
    if len(files) == 1 and not _has_compressed(metadata, "message"):
        return files[0]
    if not (path / "metadata.yaml").exists():
        raise RecordingFileError(
            f"{path}: is a folder without metadata.yaml, so it is not a bag; "
            "`ros2 bag reindex` makes one for a bag that was cut short"
        )
    return None


def _metadata(bag: Path) -> str:
    try:
        return (bag / "metadata.yaml").read_text(errors="replace")
    except OSError:  # of a bag that is not finished
        return ""


def _has_compressed(metadata: str, what: str) -> bool:
    """Check that a bag compresses each ``file`` as a whole, or each ``message`` in a file."""
    pattern = rf"^\s*compression_mode:\W*(?:{what})\b"
    return re.search(pattern, metadata, re.IGNORECASE | re.MULTILINE) is not None


# What a source yields: each channel with its schema, before the first of its messages.
_Item: TypeAlias = tuple[Channel, Schema | None] | MessageRecord


_COMPUTED = (  # in this order, as to list the columns of a virtual table is to compute
    # A view and a virtual table have no page of their own; a trigger does nothing to who reads.
    "SELECT type, name FROM sqlite_master WHERE ifnull(rootpage, 0) = 0 AND type != 'trigger'",
    "SELECT 'column', m.name || '.' || x.name FROM sqlite_master AS m,"
    " pragma_table_xinfo(m.name) AS x WHERE m.type = 'table' AND x.hidden",
)


def _check_databases(path: Path) -> None:
    """Refuse databases some of which is computed as it is read, or not in the file itself."""
    import sqlite3

    for file in [path] if path.suffix == ".db3" else sorted(path.glob("*.db3")):
        log = file.with_name(f"{file.name}-wal")
        if log.exists() and log.stat().st_size:
            raise RecordingFileError(
                f"{file}: was not closed, messages are in {log.name}; put them into it: "
                f"sqlite3 {file} 'PRAGMA wal_checkpoint(TRUNCATE)'"
            )
        try:
            with closing(sqlite3.connect(f"file:{quote(str(file))}?immutable=1", uri=True)) as rows:
                computed = next((found for each in _COMPUTED for found in rows.execute(each)), None)
        except sqlite3.Error as error:
            raise RecordingFileError(f"{file}: cannot be read as a bag: {error}") from error
        if computed:
            kind, name = computed
            raise RecordingFileError(
                f"{file}: cannot be read as a bag: its {kind} {name} is computed as it is read"
            )


def _temporary(owner: object) -> Path:
    """Make a folder that is removed with `owner`; remove those of processes that were killed."""
    pid, started, _, namespace = this_process()
    for left in Path(gettempdir()).glob(f"{_TEMPORARY}{namespace}-*-*-*"):
        of, born, _ = left.name.removeprefix(f"{_TEMPORARY}{namespace}-").split("-", 2)
        if started and of.isdecimal() and born.isdecimal() and not lives(int(of), int(born)):
            shutil.rmtree(left, ignore_errors=True)  # which no other user's is
    folder = Path(mkdtemp(prefix=f"{_TEMPORARY}{namespace}-{pid}-{started}-"))
    weakref.finalize(owner, _remove, folder, pid)
    return folder


def _remove(folder: Path, pid: int) -> None:
    if os.getpid() == pid:  # not in a process that was forked
        shutil.rmtree(folder, ignore_errors=True)


def _uncompressed(bag: Path, folder: Path, *, by_file: bool) -> Path:
    """Make a bag whose files are as they are, for one that compresses them or their messages.

    Files are unpacked if they are compressed as a whole; else there are links to them.
    """
    from ruamel.yaml import YAML
    from zstandard import ZstdDecompressor

    yaml = YAML(typ="safe", pure=True)
    made = folder / "unpacked"
    made.mkdir()
    about = yaml.load(bag / "metadata.yaml")
    bag_about = about["rosbag2_bagfile_information"]
    if (known := bag_about["compression_format"]) != "zstd":
        raise ValueError(f"compression by {known!r} is not supported, only by zstd")
    names = [Path(name).name.removesuffix(".zstd") for name in bag_about["relative_file_paths"]]
    for name in names:
        if not by_file:
            (made / name).symlink_to((bag / name).absolute())
            continue
        source = bag / f"{name}.zstd"
        most = max(_LEAST_UNPACKED, _MOST_TIMES * source.stat().st_size)
        with source.open("rb") as packed, (made / name).open("wb") as file:
            for part in ZstdDecompressor(max_window_size=_WINDOW).read_to_iter(packed):
                file.write(part)
                if file.tell() > most:
                    raise ValueError(
                        f"{source.name} unpacks to more than {_MOST_TIMES} times its size; "
                        f"if you trust it, unpack it with zstd -d"
                    )
    bag_about |= {"relative_file_paths": names, "compression_format": "", "compression_mode": ""}
    yaml.dump(about, made / "metadata.yaml")
    return made


def _unpacked_message(data: bytes) -> bytes:
    from zstandard import ZstdDecompressor

    found = ZstdDecompressor(max_window_size=_WINDOW).stream_reader(data).read(LARGEST_CHUNK + 1)
    if len(found) > LARGEST_CHUNK:
        raise ValueError(f"a message unpacks to more than {LARGEST_CHUNK} bytes")
    return found


def _by_rosbags(bag_path: Path, folder: Path) -> Iterator[_Item]:
    """Read a bag by rosbags; unpack its files into a folder if they are compressed."""
    from rosbags.rosbag2 import Reader

    types = TypeLibrary()
    try:
        path = bag_path
        _check_databases(path)
        metadata = _metadata(path) if path.is_dir() else ""
        by_file, by_message = (_has_compressed(metadata, each) for each in ("file", "message"))
        if by_file or by_message:  # which rosbags would unpack without a limit
            path = _uncompressed(path, folder, by_file=by_file)
            _check_databases(path)
        unpack = _unpacked_message if by_message else bytes
        with Reader(path) as bag:
            for number, each in enumerate(bag.connections, 1):
                text = each.msgdef.data
                if not text or each.msgdef.format.name != "MSG":
                    text = _known_text(types, each.msgtype)
                schema = Schema(number, text.encode(), SchemaEncoding.ROS2, each.msgtype)
                yield Channel(each.id, each.topic, CDR, {}, number), schema
            for connection, stamp_ns, data in bag.messages():
                yield MessageRecord(stamp_ns, stamp_ns, 0, connection.id, unpack(data))
        shutil.rmtree(folder / "unpacked", ignore_errors=True)
    except RecordingFileError:
        raise
    except Exception as error:  # whatever rosbags raises for a bag that is none
        raise RecordingFileError(f"{bag_path}: cannot be read as a bag: {error}") from error


def _known_text(types: TypeLibrary, name: str) -> str:
    """Return the definition of a type; empty if it is unknown, which is then the topic's fault."""
    try:
        return bundled(types.sources(name))
    except RosTypeError:
        return ""


def _unchunked(source: McapFile) -> Iterator[_Item]:
    """Yield a file's messages in the order in which they were written, as far as they are whole."""
    schemas: dict[int, Schema | None] = {0: None}
    channels: set[int] = set()
    try:
        with source.path.open("rb") as file:
            for record in StreamReader(file, record_size_limit=LONGEST_RECORD).records:
                match record:
                    case Schema():
                        schemas[record.id] = record
                    case Channel():
                        yield record, schemas[record.schema_id]
                        channels.add(record.id)
                    case McapMessage():
                        if record.channel_id not in channels:
                            raise ValueError("a message without a channel")
                        times = record.log_time, record.publish_time
                        place = record.sequence, record.channel_id
                        yield MessageRecord(*times, *place, record.data)
    except Exception:  # whatever the library raises for a file that is cut short or damaged
        source.complete = False


def _chunked(source: McapFile) -> Iterator[_Item]:
    for channel in source.channels.values():
        yield channel, source.schemas.get(channel.schema_id)
    yield from Index(source).in_order(source.channels)


def _converted(
    path: Path,
    items: Iterator[_Item],
    keyed: Mapping[str, RelayConfig],
    folder: Path,
    source: McapFile | None = None,
) -> McapFile:
    """Write what a source yields to a file in a folder; `source` is the file it is from, if any."""
    target = folder / "bag.mcap"
    channels: dict[int, _CopiedChannel | _SplitChannel] = {}
    with target.open("wb") as file:
        writer = Writer(file)
        writer.start(profile=Profile.ROS2)
        for each in source.metadata if source is not None else ():
            writer.add_metadata(each.name, each.metadata)
        for held in source.attachments if source is not None else ():
            writer.add_attachment(
                held.create_time, held.log_time, held.name, held.media_type, held.data
            )
        for item in items:
            if isinstance(item, MessageRecord):
                channels[item.channel].write(item)
                continue
            channel, schema = item
            relay = _relay_of(channel, keyed)
            if relay is None or schema is None:
                channels[channel.id] = _CopiedChannel(channel, schema, writer)
            else:
                channels[channel.id] = _SplitChannel(path, channel, schema, relay, writer)
        writer.finish()
    for split in channels.values():
        if isinstance(split, _SplitChannel):
            split.warn()
    found = McapFile(target)
    found.complete = source is None or source.complete
    return found


def _relay_of(channel: Channel, keyed: Mapping[str, RelayConfig]) -> RelayConfig | None:
    if channel.message_encoding != CDR:
        return None
    return keyed.get(channel.topic.lstrip("/"))


class _CopiedChannel:
    """A channel whose messages stay as they are."""

    def __init__(self, channel: Channel, schema: Schema | None, writer: Writer) -> None:
        self._writer = writer
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


class _SplitChannel:
    """The channel of a keyed topic: each key gets a channel of its own, with its slot's name.

    Messages that cannot be split are left out.
    """

    def __init__(
        self, path: Path, channel: Channel, schema: Schema, relay: RelayConfig, writer: Writer
    ) -> None:
        self._path = path
        self._topic = channel.topic
        self._relay = relay
        self._writer = writer
        self._channels: dict[str, int] = {}
        self._left_out = 0
        self._why = ""  # the first one was
        try:
            types = library_of(schema)
            self._of: RosMessage[Any] = types.message(schema.name)
            self._keys = KeyPath(str(relay.keyed_by), self._of.message)
            self._part: RosMessage[Any] = types.of(self._keys.part)
            text = bundled(types.sources(self._part.name))
        except (KeyPathError, RosTypeError) as error:
            raise RecordingFileError(f"{path}: topic {channel.topic}: {error}") from error
        self._schema = writer.register_schema(self._part.name, SchemaEncoding.ROS2, text.encode())

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

    def warn(self) -> None:
        """Log how many messages were left out, and why the first one was."""
        if self._left_out:
            what = f"{self._left_out} messages of {self._topic} were left out"
            logger().warning("%s: %s: %s", self._path, what, self._why)

    def _leave_out(self, error: Exception) -> None:
        self._left_out += 1
        self._why = self._why or str(error)

    def _add_channel(self, key: str) -> int:
        if not key:
            raise KeyPathError("a message has an empty key")
        slot = Slot(f"{self._relay.slot}/{key}", self._part.message)
        about = {SLOT: slot.name, CAPACITY: str(self._relay.capacity or 0)}
        number = self._writer.register_channel(self._topic, CDR, self._schema, about)
        self._channels[key] = number
        return number
