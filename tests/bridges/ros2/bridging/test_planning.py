"""What is wrong with a configuration, and where."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from llfsm.bridges.ros2.bridging.bridge_config import BridgeConfig
from llfsm.bridges.ros2.bridging.bridge_plan import RelayEdge, find_cycle, make_plan
from llfsm.bridges.ros2.bridging.service_slots import capacity_for
from llfsm.bridges.ros2.qos import DurabilityPolicy, Qos, ReliabilityPolicy
from llfsm.whiteboard import Slot, Whiteboard
from llfsm.whiteboard.messages.geometry_msgs import Twist
from llfsm.whiteboard.messages.std_msgs import String

POSE = {"slot": "pose", "type": "turtlesim/msg/Pose", "direction": "from_ros"}
TEXT = {"slot": "text", "type": "std_msgs/msg/String", "direction": "to_ros"}
SPAWN = {"service": "spawn", "type": "turtlesim/srv/Spawn"}
ROTATE = {"action": "rotate", "type": "turtlesim/action/RotateAbsolute"}


def planned(config, slots=(), folder=Path()):
    return make_plan(msgspec.convert(config, BridgeConfig), folder, list(slots))


def test_a_relay_as_it_is_when_little_is_configured():
    plan, faults = planned({"relay": [POSE, TEXT]})
    assert not faults
    pose, text = plan.relays
    assert (pose.topic, pose.to_ros, pose.from_ros, pose.period) == ("/pose", None, Qos(depth=1), 0)
    assert (text.topic, text.to_ros, text.from_ros) == ("/text", Qos(depth=10), None)
    assert (pose.slot.capacity, text.slot.capacity) == (1024, 65536)


def test_a_relay_as_it_is_when_all_is_configured():
    relay = TEXT | {
        "topic": "~/said",
        "direction": "both",
        "reliability": "best_effort",
        "durability": "transient_local",
        "depth": 3,
        "rate": 4,
        "capacity": 99,
    }
    plan, faults = planned({"node": "/robot/mouth", "relay": [relay]})
    assert not faults
    (made,) = plan.relays
    qos = Qos(ReliabilityPolicy.BEST_EFFORT, DurabilityPolicy.TRANSIENT_LOCAL, depth=3)
    assert (made.topic, made.to_ros, made.from_ros) == ("/robot/mouth/said", qos, qos)
    assert (made.period, made.slot.capacity) == (0.25, 99)


WRONG = [
    ({"node": "a b"}, ("node",), "not a node name"),
    ({"types": ["nowhere"]}, ("types",), "nowhere"),
    ({"relay": [TEXT, POSE | {"type": "turtlesim/msg/Pos"}]}, ("relay", 1, "type"), "Pose"),
    ({"relay": [POSE | {"type": "turtlesim/srv/Spawn"}]}, ("relay", 0, "type"), "service"),
    ({"relay": [POSE | {"slot": "9"}]}, ("relay", 0, "slot"), "'9' is not a name"),
    ({"relay": [POSE | {"topic": "a//b"}]}, ("relay", 0, "topic"), "'a//b' is not a name"),
    ({"relay": [POSE | {"slot": "a b", "topic": "a"}]}, ("relay", 0, "slot"), "white space"),
    ({"relay": [POSE, TEXT | {"slot": "pose", "topic": "t"}]}, ("relay", 1, "slot"), "Pose"),
    ({"relay": [POSE, TEXT | {"topic": "pose"}]}, ("relay", 1, "type"), "turtlesim/msg/Pose"),
    ({"relay": [POSE, POSE]}, ("relay", 1), "twice"),
    ({"relay": [POSE, POSE | {"direction": "both"}]}, ("relay", 1), "twice"),
    ({"relay": [POSE, POSE | {"direction": "to_ros"}]}, ("relay", 1), 'direction = "both"'),
    ({"client": [SPAWN | {"type": "turtlesim/msg/Pose"}]}, ("client", 0, "type"), "message"),
    ({"client": [SPAWN | {"service": "a b"}]}, ("client", 0, "service"), "'a b'"),
    ({"server": [SPAWN | {"slots": "a b"}]}, ("server", 0, "slots"), "white space"),
    ({"server": [SPAWN, SPAWN | {"slots": "b"}]}, ("server", 1, "service"), "already served"),
    ({"client": [SPAWN], "server": [SPAWN]}, ("server", 0), "already has a service"),
    (
        {
            "turtle_position": {"pose": "pose"},
            "server": [
                {"service": "turtle_position", "type": "turtle_sensor_poster/srv/TurtlePosition"}
            ],
        },
        ("server", 0),
        "already has a service",
    ),
    ({"action": [ROTATE | {"type": "turtlesim/srv/Spawn"}]}, ("action", 0, "type"), "service"),
    ({"action": [ROTATE | {"action": "a b"}]}, ("action", 0, "action"), "'a b'"),
    ({"action": [ROTATE | {"slots": "a b"}]}, ("action", 0, "slots"), "white space"),
    ({"relay": [TEXT | {"at_loss": {"data": 1}}]}, ("relay", 0, "at_loss"), "data"),
    (
        {"relay": [POSE | {"direction": "from_ros", "at_loss": {}}]},
        ("relay", 0, "at_loss"),
        "to ROS",
    ),
    ({"action": [ROTATE, ROTATE]}, ("action", 1), "already has an action"),
    (
        {"action": [ROTATE | {"role": "server", "slots": slots} for slots in "ab"]},
        ("action", 1, "action"),
        "already served",
    ),
    ({"turtle_position": {"pose": "a b"}}, ("turtle_position", "pose"), "white space"),
    (
        {"relay": [TEXT], "turtle_position": {"pose": "text"}},
        ("turtle_position", "pose"),
        "std_msgs/msg/String",
    ),
]


@pytest.mark.parametrize(("config", "where", "what"), WRONG, ids=lambda x: str(x)[:40])
def test_what_is_wrong_is_reported_with_its_place(config, where, what):
    _, faults = planned(config)
    assert faults
    assert faults[0].where == where
    assert what in faults[0].what
    assert "\n" not in faults[0].what


def test_all_that_is_wrong_is_reported():
    _, faults = planned({"relay": [POSE | {"type": "a"}, POSE | {"slot": "9"}, TEXT]})
    assert [fault.where for fault in faults] == [("relay", 0, "type"), ("relay", 1, "slot")]


def test_a_slot_that_is_on_the_board_must_be_what_is_asked_for(tmp_path):
    with Whiteboard("test", directory=tmp_path) as board:
        board.add_message(Slot("text", Twist), Twist())
        board.add_message(Slot("said", String, 100), String("x"))
        relays = [TEXT, TEXT | {"slot": "said", "capacity": 200}, TEXT | {"slot": "new"}]
        plan, faults = planned({"relay": relays}, board.slots())
    assert [fault.where for fault in faults] == [("relay", 0, "slot"), ("relay", 1, "capacity")]
    assert "holds geometry_msgs/msg/Twist, not our std_msgs/msg/String" in faults[0].what
    assert "capacity of 100" in faults[1].what
    assert [relay.slot.name for relay in plan.relays] == ["said", "new"]


def test_types_are_looked_for_beside_the_file(tmp_path):
    folder = tmp_path / "own_msgs" / "msg"
    folder.mkdir(parents=True)
    (folder / "Mood.msg").write_text("bool happy\n")
    config = {"types": ["own_msgs"], "relay": [TEXT | {"type": "own_msgs/msg/Mood"}]}
    plan, faults = planned(config, folder=tmp_path)
    assert not faults
    assert plan.relays[0].slot.type.__struct_fields__ == ("happy",)


def test_messages_that_would_go_round_are_reported():
    def relay(slot, topic, direction):
        return {"slot": slot, "topic": topic, "type": TEXT["type"], "direction": direction}

    round_trip = [
        relay("s1", "t1", "to_ros"),
        relay("s2", "t1", "from_ros"),
        relay("s2", "t2", "to_ros"),
    ]
    assert not planned({"relay": round_trip})[1]
    (fault,) = planned({"relay": [*round_trip, relay("s1", "t2", "from_ros")]})[1]
    for place in ("slot s1", "topic /t1", "slot s2", "topic /t2"):
        assert place in fault.what


def test_a_star_of_relays_of_both_directions_is_no_loop():
    edges = [RelayEdge(i, *pair) for i in range(4) for pair in (("s", f"t{i}"), (f"t{i}", "s"))]
    assert find_cycle(edges) is None


def test_a_ring_of_relays_of_both_directions_is_one():
    ring = [("s", "t"), ("t", "r"), ("r", "q"), ("q", "s")]
    edges = [RelayEdge(i, *pair) for i, (a, b) in enumerate(ring) for pair in ((a, b), (b, a))]
    found = find_cycle(edges)
    assert found is not None
    assert set(found[1]) == {"s", "t", "r", "q"}


@given(st.lists(st.tuples(st.integers(0, 5), st.integers(6, 11), st.integers(0, 2)), max_size=12))
def test_a_loop_is_found_exactly_if_a_message_could_travel_for_ever(relays):
    """Against walking as many steps as there are places to be in."""
    edges = []
    for i, (slot, topic, way) in enumerate(relays):
        if way in (0, 2):
            edges.append(RelayEdge(i, str(slot), str(topic)))
        if way in (1, 2):
            edges.append(RelayEdge(i, str(topic), str(slot)))
    travelling = {(edge.target, edge.relay) for edge in edges}
    for _ in range(2 * len(edges) + 1):
        travelling = {
            (edge.target, edge.relay)
            for place, relay in travelling
            for edge in edges
            if edge.source == place and edge.relay != relay
        }
    assert (find_cycle(edges) is not None) == bool(travelling)


@pytest.mark.parametrize(
    "name",
    ["geometry_msgs/msg/PoseWithCovarianceStamped", "sensor_msgs/msg/Imu", "turtlesim/msg/Pose"],
)
def test_a_slot_has_room_for_the_longest_message_of_its_type(types, name):
    """Every number of the longest kind, every text as long as a header's may well be."""
    of = types.message(name)

    def longest(kind):
        if kind is float:
            return 1e-300
        if isinstance(kind, type) and issubclass(kind, msgspec.Struct):
            return kind(*(longest(field.type) for field in msgspec.structs.fields(kind)))
        info = msgspec.inspect.type_info(kind)
        if isinstance(info, msgspec.inspect.VarTupleType):
            return tuple(longest(float) for _ in range(info.max_length or 0))
        if isinstance(info, msgspec.inspect.IntType):
            return info.le
        return "x" * 255

    slot = Slot("s", of.message, capacity_for(of.message))
    assert len(slot.encoder.encode(longest(of.message))) <= slot.capacity


def relay_of(name, **more):
    return {"slot": "s", "type": name, "direction": "from_ros", **more}


FITS = {
    "sensor_msgs/msg/Image": {"data": bytes(1280 * 720 * 3)},
    "sensor_msgs/msg/CompressedImage": {"data": bytes((1 << 20) - 1000)},
    "sensor_msgs/msg/PointCloud2": {"data": bytes(65_536 * 48)},
    "sensor_msgs/msg/LaserScan": {"ranges": (1e-9,) * 3600, "intensities": (1e-9,) * 3600},
    "sensor_msgs/msg/JointState": {
        "name": ("a_joint_of_an_arm",) * 1000,
        **dict.fromkeys(("position", "velocity", "effort"), (1e-9,) * 1000),
    },
    "sensor_msgs/msg/Joy": {"axes": (1e-9,) * 6000, "buttons": (1,) * 1000},
}


@pytest.mark.parametrize("name", FITS)
def test_what_sensors_usually_send_fits_in_a_new_slot_and_the_size_is_noted(types, name):
    plan, faults = planned({"relay": [relay_of(name)]})
    assert not faults
    assert not plan.warnings
    (note,) = plan.notes
    assert note.where == ("relay", 0, "type")
    slot = plan.relays[0].slot
    assert f"{slot.capacity:,} bytes" in note.what
    assert len(slot.encoder.encode(slot.type(**FITS[name]))) <= slot.capacity


BULK = [
    "nav_msgs/msg/OccupancyGrid",
    "std_msgs/msg/Float64MultiArray",
    "std_msgs/msg/ByteMultiArray",
]


@pytest.mark.parametrize("name", BULK)
def test_data_without_a_bound_and_without_a_capacity_is_warned_of(name):
    (warning,) = planned({"relay": [relay_of(name)]})[0].warnings
    assert warning.where == ("relay", 0, "capacity")
    assert "65,536 bytes" in warning.what
    assert not planned({"relay": [relay_of(name, capacity=10**6)]})[0].warnings


def test_a_slot_that_is_too_small_for_a_sensor_is_warned_of(tmp_path):
    image = relay_of("sensor_msgs/msg/Image")
    (warning,) = planned({"relay": [image | {"capacity": 65536}]})[0].warnings
    assert "65,536 bytes" in warning.what
    assert not planned({"relay": [image | {"capacity": 640 * 480}]})[0].warnings
    plan, _ = planned({"relay": [image]})
    with Whiteboard("test", directory=tmp_path) as board:
        board[Slot("s", plan.relays[0].slot.type)].reserve()  # a machine's, of 1 KiB
        (warning,) = planned({"relay": [image]}, board.slots())[0].warnings
    assert "1,024 bytes" in warning.what


@pytest.mark.parametrize(
    "name", ["std_msgs/msg/String", "tf2_msgs/msg/TFMessage", "turtlesim/msg/Pose"]
)
def test_texts_and_what_is_bounded_need_no_remark(name):
    plan, _ = planned({"relay": [relay_of(name)]})
    assert not plan.warnings
    assert not plan.notes
