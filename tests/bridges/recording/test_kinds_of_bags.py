"""Bags as rosbag2's settings make them: compressed, without chunks, with topics nobody knows."""

from __future__ import annotations

import gc
import os
import signal
import sqlite3
import subprocess
import sys
import tempfile
from contextlib import closing

import pytest
import zstandard
from mcap.writer import CompressionType, Writer
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as BagsWriter
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from llfsm.bridges.recording.bags import BagTopics
from llfsm.bridges.recording.errors import RecordingFileError
from llfsm.bridges.recording.reader import Recording
from llfsm.bridges.ros2.bridging.bridge_config import BridgeConfig, RelayConfig
from llfsm.bridges.ros2.types import TypeLibrary
from llfsm.bridges.ros2.types.definition import bundled
from waiting import wait_for

TYPES = TypeLibrary()
VECTOR = "geometry_msgs/msg/Vector3"
STORE = get_typestore(Stores.ROS2_JAZZY)
STORE.register(get_types_from_msg("int32 number", "own/msg/Odd"))
COUNT = 30
FROM_NS = 1_700_000_000_000_000_000


def points(recording, slot="point"):
    return [recording.message(of, each).x for of, each in recording.messages({slot})]


EXPECTED = [float(n) for n in range(COUNT)]


def by_rosbags(path, plugin, mode=CompressionMode.NONE, *, step_ns=1):
    writer = BagsWriter(path, version=9, storage_plugin=plugin)
    if mode is not CompressionMode.NONE:
        writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        point = writer.add_connection("/point", VECTOR, typestore=STORE)
        odd = writer.add_connection("/odd", "own/msg/Odd", typestore=STORE)
        for n in range(COUNT):
            message = STORE.types[VECTOR](float(n), 0.0, 0.0)
            writer.write(point, FROM_NS + n * step_ns, STORE.serialize_cdr(message, VECTOR))
            other = STORE.types["own/msg/Odd"](n)
            writer.write(odd, FROM_NS + n * step_ns, STORE.serialize_cdr(other, "own/msg/Odd"))
    return path


SETTINGS = [
    (StoragePlugin.SQLITE3, CompressionMode.FILE),
    (StoragePlugin.SQLITE3, CompressionMode.MESSAGE),
    (StoragePlugin.MCAP, CompressionMode.FILE),
    (StoragePlugin.MCAP, CompressionMode.MESSAGE),
    (StoragePlugin.MCAP, CompressionMode.STORAGE),
]


@pytest.mark.parametrize(("plugin", "mode"), SETTINGS)
def test_a_compressed_bag_is_read(tmp_path, plugin, mode):
    assert points(Recording(by_rosbags(tmp_path / "bag", plugin, mode))) == EXPECTED


@pytest.mark.parametrize(("plugin", "mode"), SETTINGS[:4])
def test_a_file_of_a_compressed_bag_is_refused_with_the_bags_name(tmp_path, plugin, mode):
    bag = by_rosbags(tmp_path / "bag", plugin, mode)
    (file,) = (each for each in bag.iterdir() if each.name != "metadata.yaml")
    with pytest.raises(RecordingFileError, match=f"compressed; name the bag instead: {bag}"):
        Recording(file)


def bomb(bag, mode):
    """Let a bag's only file, or its last message, unpack to far more than it should."""
    if mode is CompressionMode.FILE:
        (file,) = bag.glob("*.zstd")
        with zstandard.ZstdCompressor().stream_writer(file.open("wb")) as stream:
            for _ in range(300):
                stream.write(bytes(1 << 20))
    else:
        packed = zstandard.compress(bytes(100 << 20))
        with closing(sqlite3.connect(next(bag.glob("*.db3")))) as database:
            database.execute("UPDATE messages SET data = ? WHERE id = ?", (packed, COUNT))
            database.commit()
    return bag


@pytest.mark.parametrize(
    ("mode", "text"),
    [
        (CompressionMode.FILE, "unpacks to more than 100 times its size; if you trust it, unpack"),
        (CompressionMode.MESSAGE, "a message unpacks to more than 67108864 bytes"),
    ],
)
def test_what_unpacks_to_too_much_is_refused_and_leaves_nothing(tmp_path, monkeypatch, mode, text):
    bag = bomb(by_rosbags(tmp_path / "bag", StoragePlugin.SQLITE3, mode), mode)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "made"))
    (tmp_path / "made").mkdir()
    with pytest.raises(RecordingFileError, match=text):
        Recording(bag)
    gc.collect()
    assert [*(tmp_path / "made").iterdir()] == []


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGKILL])
def test_a_command_that_is_ended_leaves_no_temporary_file(tmp_path, number):
    bag = by_rosbags(tmp_path / "bag", StoragePlugin.SQLITE3, step_ns=10**10)
    (made := tmp_path / "made").mkdir()
    environment = os.environ | {"TMPDIR": str(made)}
    command = [sys.executable, "-m", "llfsm.cli", "replay", str(bag), "-b", "b"]
    command += ["--directory", str(tmp_path)]
    with subprocess.Popen(command, env=environment) as process:
        wait_for(lambda: (tmp_path / "llfsm.b").exists(), "the replay has begun")
        assert [*made.glob("*/bag.mcap")]
        process.send_signal(number)
    assert len([*made.iterdir()]) == (number == signal.SIGKILL)
    reading = "import sys; from llfsm.bridges.recording.reader import Recording; "
    code = f"{reading}Recording(__import__('pathlib').Path(sys.argv[1]))"
    subprocess.run([sys.executable, "-c", code, str(bag)], env=environment, check=True)
    assert [*made.iterdir()] == []


def by_mcap(path, *, more=lambda writer: None, **settings):
    with path.open("wb") as stream:
        writer = Writer(stream, **settings)
        writer.start(profile="ros2")
        more(writer)
        schema = writer.register_schema(VECTOR, "ros2msg", bundled(TYPES.sources(VECTOR)).encode())
        channel = writer.register_channel("/point", "cdr", schema)
        of = TYPES.message(VECTOR)
        for n, x in enumerate(EXPECTED):
            writer.add_message(channel, FROM_NS + n, of.encode(of.message(x=x)), FROM_NS + n, n)
        writer.finish()
    return path


@pytest.mark.parametrize("compression", CompressionType)
def test_chunks_of_any_compression_and_size_are_read(tmp_path, compression):
    made = by_mcap(tmp_path / "bag.mcap", compression=compression, chunk_size=100)
    assert points(Recording(made)) == EXPECTED


@pytest.mark.parametrize("index", [True, False])
def test_a_bag_without_chunks_is_read(tmp_path, index):
    unchunked = by_mcap(tmp_path / "bag.mcap", use_chunking=False, use_statistics=index)
    recording = Recording(unchunked)
    assert points(recording) == EXPECTED
    assert recording.complete
    assert recording.span_ns == (0, COUNT - 1)


def test_as_much_of_a_bag_without_chunks_is_read_as_there_is(tmp_path):
    unchunked = by_mcap(tmp_path / "bag.mcap", use_chunking=False)
    unchunked.write_bytes(unchunked.read_bytes()[:1500])
    recording = Recording(unchunked)
    found = points(recording)
    assert 0 < len(found) < COUNT
    assert found == EXPECTED[: len(found)]
    assert not recording.complete


def test_keyed_relays_are_looked_for_in_a_bag_without_chunks_too(tmp_path):
    relay = RelayConfig(slot="x", topic="/point", type=VECTOR, direction="from_ros", keyed_by="x")
    made = by_mcap(tmp_path / "bag.mcap", use_chunking=False)
    with pytest.raises(RecordingFileError, match=r"topic /point: .*'x'"):  # a float is no key
        Recording(made, BagTopics(BridgeConfig(relay=(relay,))))


def without_definition(writer):
    schema = writer.register_schema("own/msg/Odd", "", b"")
    writer.add_message(writer.register_channel("/odd", "cdr", schema), FROM_NS, bytes(8), FROM_NS)


def not_cdr(writer):
    schema = writer.register_schema("odd", "jsonschema", b"{}")
    writer.add_message(writer.register_channel("/odd", "json", schema), FROM_NS, b"{}", FROM_NS)


def without_type(writer):
    writer.add_message(writer.register_channel("/odd", "cdr", 0), FROM_NS, bytes(8), FROM_NS)


def of_two_types(writer):
    without_definition(writer)
    for kind in ("String", "Bool"):
        text = bundled(TYPES.sources(f"std_msgs/msg/{kind}"))
        schema = writer.register_schema(f"std_msgs/msg/{kind}", "ros2msg", text.encode())
        writer.register_channel("/odd", "cdr", schema)


@pytest.mark.parametrize(
    ("more", "why"),
    [
        (without_definition, "own/msg/Odd: no definition"),
        (not_cdr, "its messages are json, not cdr"),
        (without_type, "it has no type"),
        (of_two_types, "odd has messages of two types"),
    ],
)
def test_a_topic_that_cannot_be_read_is_left_out_with_a_warning(tmp_path, caplog, more, why):
    recording = Recording(by_mcap(tmp_path / "bag.mcap", more=more))
    assert points(recording) == EXPECTED
    assert f"topic /odd is left out: {why}" in caplog.text


def test_a_bag_in_sqlite_from_before_definitions_were_kept_is_read(tmp_path, caplog):
    bag = by_rosbags(tmp_path / "bag", StoragePlugin.SQLITE3)
    (file,) = bag.glob("*.db3")
    with sqlite3.connect(file) as database:
        database.execute("delete from message_definitions")
    recording = Recording(bag)
    assert points(recording) == EXPECTED
    assert "topic /odd is left out: own/msg/Odd: no definition" in caplog.text


ENDLESS = "WITH RECURSIVE c(n) AS (SELECT 1 UNION ALL SELECT n + 1 FROM c) SELECT max(n) FROM c"


@pytest.mark.parametrize("table", ["messages", "topics", "message_definitions", "schema"])
def test_a_bag_with_a_view_that_computes_is_refused(tmp_path, table):
    """Reading it would never end."""
    bag = by_rosbags(tmp_path / "bag", StoragePlugin.SQLITE3)
    (file,) = bag.glob("*.db3")
    with closing(sqlite3.connect(file)) as database:
        columns = [name for _, name, *_ in database.execute(f"PRAGMA table_info({table})")]
        database.execute(f"ALTER TABLE {table} RENAME TO kept")
        found = ", ".join(f"({ENDLESS}) AS {name}" for name in columns)
        database.execute(f"CREATE VIEW {table} AS SELECT {found} FROM kept")
        database.commit()
    with pytest.raises(RecordingFileError, match=f"its view {table} is computed as it is read"):
        Recording(bag)


def test_a_trigger_does_nothing_to_who_reads(tmp_path):
    bag = by_rosbags(tmp_path / "bag", StoragePlugin.SQLITE3)
    with closing(sqlite3.connect(next(bag.glob("*.db3")))) as database:
        database.execute("CREATE TRIGGER t AFTER INSERT ON messages BEGIN DELETE FROM topics; END")
        database.commit()
    assert points(Recording(bag)) == EXPECTED


def test_another_compression_is_named(tmp_path):
    bag = by_rosbags(tmp_path / "bag", StoragePlugin.SQLITE3, CompressionMode.FILE)
    about = bag / "metadata.yaml"
    about.write_text(
        about.read_text().replace("compression_format: zstd", "compression_format: xz")
    )
    with pytest.raises(RecordingFileError, match="compression by 'xz' is not supported, only by"):
        Recording(bag)


def test_a_bag_whose_messages_are_computed_is_refused(tmp_path):
    """Sixteen kilobytes of it would be gigabytes of messages."""
    bag = by_rosbags(tmp_path / "bag", StoragePlugin.SQLITE3)
    (file,) = bag.glob("*.db3")
    with sqlite3.connect(file) as database:
        database.execute("drop table messages")
        database.execute(
            "create table messages(id integer primary key, topic_id integer not null, "
            "timestamp integer not null, data blob generated always as (zeroblob(900000000)))"
        )
        database.execute("insert into messages(topic_id, timestamp) values(1, 1)")
    for path in (bag, file):
        with pytest.raises(RecordingFileError, match=r"column messages\.data is computed"):
            Recording(path)


def test_a_bag_that_was_not_closed_is_no_empty_one(tmp_path):
    bag = by_rosbags(tmp_path / "bag", StoragePlugin.SQLITE3)
    (file,) = bag.glob("*.db3")
    script = (
        "import os, sqlite3, sys; d = sqlite3.connect(sys.argv[1]);"
        "d.execute('pragma journal_mode=wal');"
        "d.execute('update messages set timestamp = timestamp + 1'); d.commit(); os._exit(0)"
    )
    subprocess.run([sys.executable, "-c", script, str(file)], check=True)
    with pytest.raises(RecordingFileError, match="wal_checkpoint"):
        Recording(bag)
    with closing(sqlite3.connect(file)) as database:
        database.execute("pragma wal_checkpoint(truncate)")
    assert len(points(Recording(bag))) == len(EXPECTED)
