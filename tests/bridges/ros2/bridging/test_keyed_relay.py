"""A topic with many publishers, and a slot for each key."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest

from llfsm.bridges.ros2.bridging._relays import KeyedFromRos, RelaySettings
from llfsm.bridges.ros2.bridging.bridge_config import BridgeConfig, KeyPath
from llfsm.bridges.ros2.bridging.bridge_plan import make_plan
from llfsm.bridges.ros2.bridging.link import BridgeLink
from llfsm.bridges.ros2.errors import ConnectivityError
from llfsm.bridges.ros2.qos import DurabilityPolicy, Qos
from llfsm.bridges.ros2.threads import TimerThread
from llfsm.bridges.ros2.transforms import TransformBuffer, TransformListener
from llfsm.bridges.ros2.transport import MessageInfo, Notifier, SerializedBytes
from llfsm.whiteboard import Slot
from llfsm.whiteboard.messages.builtin_interfaces import Time
from llfsm.whiteboard.messages.geometry_msgs import Transform, TransformStamped, Vector3
from llfsm.whiteboard.messages.std_msgs import Header, Int64
from waiting import wait_for

TYPE = "tf2_msgs/msg/TFMessage"
TF = {"slot": "tf", "type": TYPE, "direction": "from_ros"}
TF |= {"keyed_by": "transforms.child_frame_id"}
STATIC = TF | {"slot": "tf_static", "topic": "/tf_static", "durability": "transient_local"}


def planned(*relays, slots=()):
    plan, faults = make_plan(msgspec.convert({"relay": relays}, BridgeConfig), Path(), list(slots))
    return plan, [(fault.where, fault.what) for fault in faults]


def frame(parent, child, x, seconds=1):
    return TransformStamped(
        Header(Time(seconds), parent), child, Transform(translation=Vector3(x=x))
    )


def of(name):
    return Slot(name, TransformStamped)


def test_each_frame_has_a_slot_and_no_publisher_hides_another(board, start, peer, types):
    message = types.message(TYPE)
    bridge = start(relay=[TF])
    publishers = [peer.node(f"n{i}").publisher("/tf", message, Qos(depth=100)) for i in range(20)]
    for i, publisher in enumerate(publishers):
        publisher.publish(message.message((frame("map", f"/robot{i}/base", i),)))
    wait_for(lambda: bridge.links[0].passed == 20)
    places = [board.get_message(of(f"tf/robot{i}/base")) for i in range(20)]
    assert [place.transform.translation.x for place in places] == list(range(20))
    assert str(bridge.links[0]) == "tf/* <- /tf"


def test_transforms_are_looked_up_from_the_slots(board, start, peer, types):
    message = types.message(TYPE)
    qos = Qos(durability=DurabilityPolicy.TRANSIENT_LOCAL, depth=1)
    node = peer.node("robot")
    node.publisher("/tf_static", message, qos).publish(
        message.message((frame("base", "laser", 0.5), frame("base", "camera", 0.25)))
    )
    bridge = start(relay=[TF, STATIC])
    moving = node.publisher("/tf", message)
    buffer = TransformBuffer()
    listener = TransformListener(board, buffer)
    for seconds in (1, 3):
        moving.publish(message.message((frame("map", "base", seconds, seconds),)))
        wait_for(lambda seconds=seconds: bridge.links[0].passed == (seconds + 1) / 2)
        listener.pull()
    wait_for(lambda: bridge.links[1].passed == 2, "static frames of before")
    listener.pull()
    assert buffer.lookup("map", "laser", Time(2)).transform.translation.x == 2.5
    assert buffer.lookup("laser", "camera", Time(99)).transform.translation.x == -0.25
    buffer.add(frame("a", "b", 1))
    with pytest.raises(ConnectivityError):
        buffer.lookup("map", "b")


def test_the_rate_is_that_of_each_key(board, start, peer, types):
    message = types.message(TYPE)
    bridge = start(relay=[TF | {"rate": 0.001}])
    publisher = peer.node("robot").publisher("/tf", message, Qos(depth=100))
    for x in (1, 2):
        publisher.publish(message.message((frame("map", "a", x), frame("map", "b", x))))
    wait_for(lambda: bridge.links[0].passed == 2)
    assert [board.get_message(of(f"tf/{key}")).transform.translation.x for key in "ab"] == [1, 1]


def test_a_key_that_is_no_name_loses_nothing_else(board, start, peer, types, reported):
    message = types.message(TYPE)
    bridge = start(relay=[TF])
    publisher = peer.node("robot").publisher("/tf", message)
    for _ in range(2):
        keys = ("a b", "", "x" * 300, "good")
        publisher.publish(message.message(tuple(frame("map", key, 1) for key in keys)))
    wait_for(lambda: bridge.links[0].passed == 2)
    assert bridge.links[0].failed == 6
    assert len(reported) == 2  # one for names, one for the empty key
    assert [slot.name for slot in board.slots()] == ["tf/good"]


def test_bytes_that_are_no_message_are_counted(board, types, reported):
    link = BridgeLink("tf/*", "<-", "/tf", TYPE, Notifier(reported))
    keys, timer = KeyPath(TF["keyed_by"], types.message(TYPE).message), TimerThread("test")
    relay = KeyedFromRos(board, of("tf"), keys, link, timer, RelaySettings())
    relay.arrived(
        SerializedBytes(b"\0\1\0\0\1", MessageInfo(0, 0, b""), types.message(TYPE).decode)
    )
    timer.close()
    assert (link.passed, link.failed, len(reported)) == (0, 1, 1)


def test_a_whole_message_may_have_the_key(types):
    keys = KeyPath("header.frame_id", types.message("sensor_msgs/msg/Range").message)
    message = keys.part(header=Header(frame_id="/left"))
    assert list(keys.split(message)) == [("left", message)]
    assert list(KeyPath("data", Int64).split(Int64(7))) == [("7", Int64(7))]


@pytest.mark.parametrize(
    ("path", "why"),
    [
        ("transforms.child", "no field 'child'; there are: header, child_frame_id, transform"),
        ("transforms", "a key is a text"),
        ("transforms.header", "a key is a text"),
        ("transforms.child_frame_id.x", "there is no field 'x' in a value"),
        ("", "no field ''"),
    ],
)
def test_a_path_to_no_key_is_an_error_with_its_place(path, why):
    _, faults = planned(TF | {"keyed_by": path})
    assert [where for where, _ in faults] == [("relay", 0, "keyed_by")]
    assert why in faults[0][1]


def test_keys_come_from_ros_only():
    _, [(where, what)] = planned(TF | {"direction": "both"})
    assert where == ("relay", 0, "keyed_by")
    assert "from_ros" in what


def test_a_slot_of_a_key_with_another_type_is_an_error(board):
    board.add_message(Slot("tf/base", Int64), Int64(1))
    _, [(where, what)] = planned(TF, slots=board.slots())
    assert where == ("relay", 0, "slot")
    assert "'tf/base' holds std_msgs/msg/Int64" in what


def test_a_slot_of_a_key_that_goes_back_is_a_loop():
    forth = {"slot": "n", "topic": "a", "type": "std_msgs/msg/Int64", "direction": "from_ros"}
    back = {"slot": "n/1", "topic": "a", "type": "std_msgs/msg/Int64", "direction": "to_ros"}
    _, [(_, what)] = planned(forth | {"keyed_by": "data"}, back)
    assert "for ever" in what


def test_many_may_send_at_once():
    plan, _ = planned(TF)
    assert plan.relays[0].from_ros.depth == 100
    assert plan.relays[0].slot.capacity == 1024
