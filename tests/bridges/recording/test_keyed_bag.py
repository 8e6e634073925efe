"""A bag whose topics have many publishers: each key is a slot, as behind a live bridge."""

from __future__ import annotations

import pytest
from mcap.writer import Writer

from calling import call
from llfsm.bridges.recording.bags import BagTopics
from llfsm.bridges.recording.errors import RecordingFileError
from llfsm.bridges.recording.reader import Recording
from llfsm.bridges.ros2.bridging.bridge_config import BridgeConfig, RelayConfig
from llfsm.bridges.ros2.types import TypeLibrary
from llfsm.bridges.ros2.types.definition import bundled
from llfsm.whiteboard import Slot, Whiteboard
from llfsm.whiteboard.messages.geometry_msgs import Transform, TransformStamped, Vector3
from llfsm.whiteboard.messages.std_msgs import Header, String

TYPES = TypeLibrary()
TF = TYPES.message("tf2_msgs/msg/TFMessage")
TEXT = TYPES.message("std_msgs/msg/String")
BEGIN_NS = 1_700_000_000_000_000_000
RELAY = RelayConfig(
    slot="frames",
    topic="/tf",
    type=TF.name,
    direction="from_ros",
    keyed_by="transforms.child_frame_id",
    capacity=700,
)


def frame(child, x):
    return TransformStamped(Header(frame_id="map"), child, Transform(translation=Vector3(x=x)))


def message(**frames):
    return TF.encode(TF.message(tuple(frame(child, x) for child, x in frames.items())))


@pytest.fixture
def bag(tmp_path):
    """Write transforms of two publishers and texts, one a millisecond; return the file's path."""
    path = tmp_path / "bag.mcap"
    sent = [
        ("/tf", message(base=1.0, arm=2.0)),
        ("/chatter", TEXT.encode(String("a"))),
        ("/tf", message(wheel=3.0)),
        ("/tf", b"no message"),
        ("/tf", TF.encode(TF.message((frame("", 0.0), frame("base", 4.0))))),
    ]
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros2")
        channels = {}
        for topic, of in (("/tf", TF), ("/chatter", TEXT)):
            text = bundled(TYPES.sources(of.name))
            schema = writer.register_schema(of.name, "ros2msg", text.encode())
            channels[topic] = writer.register_channel(topic, "cdr", schema)
        for n, (topic, data) in enumerate(sent):
            stamp_ns = BEGIN_NS + n * 1_000_000
            writer.add_message(channels[topic], stamp_ns, data, stamp_ns)
        writer.finish()
    return path


def keyed(**changes):
    values = {name: getattr(RELAY, name) for name in RELAY.__struct_fields__}
    return BagTopics(BridgeConfig(relay=(RelayConfig(**values | changes),)))


def test_each_key_is_a_slot_and_whats_wrong_is_left_out_and_logged(bag, caplog):
    recording = Recording(bag, keyed())
    slots = recording.slots
    assert set(slots) == {"frames/base", "frames/arm", "frames/wheel", "chatter"}
    assert {slots[f"frames/{key}"].slot.type for key in ("base", "arm")} == {TransformStamped}
    assert slots["frames/base"].slot.capacity == 700
    found = [(slot.slot.name, slot.sample(each)) for slot, each in recording.messages()]
    places = [
        (name, sample.message.transform.translation.x, sample.stamp_ns)
        for name, sample in found
        if name != "chatter"
    ]
    assert sorted(places[:2]) == [("frames/arm", 2.0, 0), ("frames/base", 1.0, 0)]
    assert places[2:] == [("frames/wheel", 3.0, 2_000_000), ("frames/base", 4.0, 4_000_000)]
    assert "2 messages of /tf were left out" in caplog.text


def test_other_bags_are_read_as_they_are(bag, temporary):
    recording = Recording(bag, keyed(topic="/tf_static"))
    assert set(recording.slots) == {"tf", "chatter"}
    assert temporary() == []


def test_the_split_file_goes_with_the_recording(bag, temporary):
    recording = Recording(bag, keyed())
    assert len(temporary()) == 1
    del recording
    assert temporary() == []


def test_a_key_that_the_bags_type_lacks_is_an_error(bag):
    with pytest.raises(RecordingFileError, match=r"topic /tf: .*no field 'child'"):
        Recording(bag, keyed(keyed_by="transforms.child"))


def test_a_replayed_bag_fills_the_slots_of_keys(bag, board, tmp_path):
    config = tmp_path / "bridge.toml"
    config.write_text(
        f'[[relay]]\nslot = "frames"\ntopic = "/tf"\ntype = "{TF.name}"\n'
        'direction = "from_ros"\nkeyed_by = "transforms.child_frame_id"\n'
    )
    where = ["-b", board.name, "--config", "bridge.toml"]
    done = call("replay", str(bag), *where, "--speed", "1000", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    with Whiteboard(board.name) as again:
        assert again.get_message(Slot("frames/base", TransformStamped)) == frame("base", 4.0)
        assert again.get_message(Slot("frames/wheel", TransformStamped)) == frame("wheel", 3.0)
