"""Bags: ROS's own readers take ours, and we take what ROS's writers write."""

from __future__ import annotations

import pytest
from click.testing import CliRunner
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from mcap_ros2.writer import Writer as Ros2Writer
from rosbags.rosbag2 import Reader, StoragePlugin
from rosbags.rosbag2 import Writer as BagsWriter
from rosbags.typesys import Stores, get_typestore

from calling import own_logging
from llfsm.bridges.recording.bags import BagTopics, BagWriter
from llfsm.bridges.recording.errors import RecordingError, RecordingFileError
from llfsm.bridges.recording.reader import Recording
from llfsm.bridges.recording.recorders import BoardRecorder
from llfsm.bridges.recording.rerun import whole_journals
from llfsm.bridges.ros2.bridging.bridge_config import BridgeConfig, RelayConfig
from llfsm.bridges.ros2.types import TypeLibrary
from llfsm.cli.root import main
from llfsm.whiteboard import Message, Slot, Whiteboard
from llfsm.whiteboard.messages.geometry_msgs import Twist, Vector3
from llfsm.whiteboard.messages.turtlesim import Pose

TYPES = TypeLibrary()
SCAN = TYPES.message("sensor_msgs/msg/LaserScan").message
CMD = Slot("turtle1/cmd_vel", Twist)
POSE = Slot("turtle1/pose", Pose)
SCANS = Slot("scan", SCAN, 65536)
STORE = get_typestore(Stores.ROS2_JAZZY)
COUNT = 3


class Odd(Message):
    """No type of ROS."""

    number: int = 0


def moved(n):
    return Twist(linear=Vector3(x=float(n)))


def scanned(n):
    return SCAN(range_max=2.5, ranges=(0.5, float(n)))


@pytest.fixture
def bag(board, file, caplog):
    """Record three slots as a bag; a fourth has a type that ROS does not have."""
    with BagWriter(file, {"board": "b"}, TYPES) as writer:
        recorder = BoardRecorder(board, writer)
        for n in range(COUNT):
            board.add_message(CMD, moved(n))
            board.add_message(POSE, Pose(x=0.5, y=float(n)))
            board.add_message(SCANS, scanned(n))
            board.add_message(Slot("odd", Odd), Odd(n))
            recorder.poll(last=True)
    assert caplog.text.count("odd is not recorded") == 1
    return file


def test_mcap_ros2_decodes_ours_by_its_own_reading_of_the_definitions(bag):
    with bag.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        assert reader.get_header().profile == "ros2"
        found = [(c.topic, s.name, m) for s, c, _, m in reader.iter_decoded_messages()]
    assert len(found) == 3 * COUNT
    twists = [m.linear.x for topic, _, m in found if topic == "/turtle1/cmd_vel"]
    poses = [(m.x, m.y) for topic, kind, m in found if kind == "turtlesim/msg/Pose"]
    scans = [(m.range_max, list(m.ranges)) for topic, _, m in found if topic == "/scan"]
    assert twists == [0.0, 1.0, 2.0]
    assert poses == [(0.5, 0.0), (0.5, 1.0), (0.5, 2.0)]
    assert scans == [(2.5, [0.5, float(n)]) for n in range(COUNT)]


def test_rosbags_reads_ours_and_a_topic_has_one_connection(bag):
    with Reader(bag) as reader:
        assert sorted((c.topic, c.msgtype) for c in reader.connections) == [
            ("/scan", "sensor_msgs/msg/LaserScan"),
            ("/turtle1/cmd_vel", "geometry_msgs/msg/Twist"),
            ("/turtle1/pose", "turtlesim/msg/Pose"),
        ]
        (scan,) = (c for c in reader.connections if c.topic == "/scan")
        found = [
            STORE.deserialize_cdr(data, scan.msgtype) for _, _, data in reader.messages([scan])
        ]
    assert [list(each.ranges) for each in found] == [[0.5, float(n)] for n in range(COUNT)]


def test_we_read_ours_with_counts_and_types(bag):
    recording = Recording(bag)
    assert set(recording.slots) == {"scan", "turtle1/cmd_vel", "turtle1/pose"}
    assert recording.slots["turtle1/cmd_vel"].slot.type is Twist
    samples = [slot.sample(each) for slot, each in recording.messages({"turtle1/cmd_vel"})]
    assert [(s.message, s.count) for s in samples] == [(moved(n), n + 1) for n in range(COUNT)]


def written_by_mcap_ros2(path):
    with path.open("wb") as stream:
        writer = Ros2Writer(stream)
        text = TYPES.sources("geometry_msgs/msg/Twist")
        bundle = text[0].text + "\n" + "=" * 80 + "\nMSG: geometry_msgs/Vector3\n" + text[1].text
        schema = writer.register_msgdef("geometry_msgs/msg/Twist", bundle)
        for n in range(COUNT):
            message = {
                "linear": {"x": float(n), "y": 0.0, "z": 0.0},
                "angular": {"x": 0.0, "y": 0.0, "z": 0.0},
            }
            stamp_ns = 1_700_000_000_000_000_000 + n * 500_000_000
            writer.write_message("/turtle1/cmd_vel", schema, message, stamp_ns, stamp_ns)
        writer.finish()
    return path


def written_by_rosbags(path, plugin):
    vector, twist = (STORE.types[f"geometry_msgs/msg/{name}"] for name in ("Vector3", "Twist"))
    with BagsWriter(path, version=9, storage_plugin=plugin) as writer:
        connection = writer.add_connection("/turtle1/cmd_vel", twist.__msgtype__, typestore=STORE)
        for n in range(COUNT):
            message = twist(linear=vector(float(n), 0.0, 0.0), angular=vector(0.0, 0.0, 0.0))
            data = STORE.serialize_cdr(message, twist.__msgtype__)
            writer.write(connection, 1_700_000_000_000_000_000 + n * 500_000_000, data)
    return path


WRITERS = {
    "mcap_ros2": lambda folder: written_by_mcap_ros2(folder / "bag.mcap"),
    "a folder with MCAP": lambda f: written_by_rosbags(f / "bag", StoragePlugin.MCAP),
    "a folder with SQLite": lambda f: written_by_rosbags(f / "bag", StoragePlugin.SQLITE3),
    ".db3": lambda f: next(written_by_rosbags(f / "bag", StoragePlugin.SQLITE3).glob("*.db3")),
}


@pytest.mark.parametrize("writer", WRITERS)
def test_a_bag_of_another_writer_is_a_recording(tmp_path, writer):
    recording = Recording(WRITERS[writer](tmp_path))
    begin_ns, end_ns = recording.span_ns
    assert end_ns - begin_ns == 1_000_000_000
    found = [slot.sample(each) for slot, each in recording.messages()]
    assert [each.message for each in found] == [moved(n) for n in range(COUNT)]
    assert recording.slots["turtle1/cmd_vel"].slot.type is Twist
    slot = recording.slots["turtle1/cmd_vel"]
    latest = recording.latest(slot, begin_ns + 600_000_000)
    assert slot.sample(latest).message == moved(1)


def test_the_temporary_file_of_a_converted_bag_goes_with_the_recording(tmp_path, temporary):
    recording = Recording(WRITERS[".db3"](tmp_path))
    assert len(temporary()) == 1
    del recording
    assert temporary() == []


def test_a_bridges_configuration_names_the_slots(tmp_path):
    relay = RelayConfig(
        slot="drive", topic="/turtle1/cmd_vel", type="geometry_msgs/msg/Twist",
        direction="to_ros", capacity=500,
    )  # fmt: skip
    topics = BagTopics(BridgeConfig(relay=(relay,)))
    recording = Recording(WRITERS["mcap_ros2"](tmp_path), topics)
    assert list(recording.slots) == ["drive"]
    assert recording.slots["drive"].slot.capacity == 500


def llfsm(*arguments):
    with own_logging():
        return CliRunner().invoke(main, [*map(str, arguments)], catch_exceptions=False)


def test_a_whiteboard_is_recorded_as_a_bag_and_a_bag_is_replayed(board, file, tmp_path):
    board.add_message(CMD, moved(7))
    done = llfsm("record", "--cdr", "-o", file, "-b", board.name, "--max-time", 0)
    assert done.exit_code == 0, done.output
    with Reader(file) as reader:
        assert [c.topic for c in reader.connections] == ["/turtle1/cmd_vel"]
    config = tmp_path / "bridge.toml"
    config.write_text(
        '[[relay]]\nslot = "drive"\ntopic = "turtle1/cmd_vel"\n'
        'type = "geometry_msgs/msg/Twist"\ndirection = "to_ros"\n'
    )
    done = llfsm("replay", file, "-b", board.name, "--config", config, "--speed", 1000)
    assert done.exit_code == 0, done.output
    with Whiteboard(board.name) as again:
        assert again.get_message(Slot("drive", Twist)) == moved(7)


def test_a_bag_has_nothing_to_run_again(tmp_path):
    with pytest.raises(RecordingError, match="holds no events of machines"):
        whole_journals(Recording(WRITERS["mcap_ros2"](tmp_path)))


@pytest.mark.parametrize(
    ("name", "content", "what"),
    [
        ("bag.db3", b"no database", "cannot be read as a bag"),
        ("bag", None, "without metadata.yaml"),
        ("bag.mcap", b"nothing", "not a recording of llfsm, nor a bag"),
    ],
)
def test_what_is_no_bag_is_reported(tmp_path, name, content, what):
    path = tmp_path / name
    path.mkdir() if content is None else path.write_bytes(content)
    with pytest.raises(RecordingFileError, match=what):
        Recording(path)


def test_a_type_that_only_the_bag_defines_is_known(tmp_path):
    path = tmp_path / "bag.mcap"
    with path.open("wb") as stream:
        writer = Ros2Writer(stream)
        schema = writer.register_msgdef("own/msg/Thing", "int32 x")
        writer.write_message("/a", schema, {"x": 1}, 1, 1)
        writer.finish()
    recording = Recording(path)
    assert next(recording.messages())[0].slot.type.__struct_fields__ == ("x",)
