"""What a bridge lives through: routers and peers that die, nonsense on the wire, its own death."""

from __future__ import annotations

import json
import random
import signal
import time

import pytest
import zenoh

from llfsm.bridges.ros2.graph import Role
from llfsm.bridges.ros2.zenoh_transport.endpoints import pack
from llfsm.bridges.ros2.zenoh_transport.graph import data_key
from llfsm.bridges.ros2.zenoh_transport.transport import ZenohTransport
from llfsm.whiteboard import Slot
from llfsm.whiteboard.messages.std_msgs import Int64, String
from llfsm.whiteboard.messages.turtlesim import Pose
from waiting import PATIENCE_S, wait_for

TEXT, NUMBER = "std_msgs/msg/String", "std_msgs/msg/Int64"
N = Slot("n", Int64)


@pytest.fixture
def number(types):
    return types.message(NUMBER)


def publish_until_added(publisher, slot, value):
    """Publish again and again, as a sensor does, until it arrives."""

    def publish():
        publisher.publish(Int64(value))
        slot.wait(after=slot.count, timeout=0.05)

    wait_for(lambda: slot.get() == Int64(value), "the value", between=publish)


def test_a_router_that_is_killed_is_reported_and_found_again(
    bridge, own_router, free_port, board, domain, number
):
    endpoint = f"tcp/127.0.0.1:{free_port}"
    first = own_router()
    process = bridge("ros2", "--both", f"n:{NUMBER}", at=endpoint)
    with ZenohTransport(domain, router=[endpoint], notify=lambda _: None) as peer:
        publisher = peer.node("talker").publisher("n", number)
        publish_until_added(publisher, board[N], 1)
        first.end(signal.SIGKILL)
        process.says("no router")
        own_router()
        process.says("connected to a router")
    with ZenohTransport(domain, router=[endpoint], notify=lambda _: None) as newcomer:
        assert newcomer.wait_graph(lambda graph: "/llfsm_bridge" in graph.nodes, PATIENCE_S)
        publish_until_added(newcomer.node("talker").publisher("n", number), board[N], 2)
    assert process.end() == 0
    printed = "".join(process.printed)
    assert printed.count("no router") == printed.count("connected to a router") == 1


def test_a_bridge_may_be_there_before_the_router(
    bridge, own_router, free_port, board, domain, number
):
    endpoint = f"tcp/127.0.0.1:{free_port}"
    process = bridge("ros2", "--both", f"n:{NUMBER}", at=endpoint)
    if not any("no router" in line for line in process.printed):
        process.says("no router")
    own_router()
    with ZenohTransport(domain, router=[endpoint], notify=lambda _: None) as peer:
        publish_until_added(peer.node("talker").publisher("n", number), board[N], 1)


def test_a_simulator_that_is_killed_and_comes_back_is_relayed_again(
    bridge, run, board, domain, router
):
    where = ("--ros", "--transport", "zenoh", "--domain", str(domain), "--router", router)
    process = bridge("turtlesim")
    pose = board[Slot("turtle1/pose", Pose)]
    simulator = run("turtlesim", *where)
    assert pose.wait(after=0, timeout=PATIENCE_S) is not None
    simulator.end(signal.SIGKILL)
    while pose.wait(after=pose.count, timeout=0.5) is not None:
        pass  # what was on its way
    count = pose.count  # and nothing false is added while nobody publishes
    run("turtlesim", *where)
    assert pose.wait(after=count, timeout=PATIENCE_S) is not None
    assert process.end() == 0


def test_a_bridge_that_is_killed_leaves_the_graph_and_its_successor_goes_on(
    bridge, board, peer, number, seen
):
    received = seen()
    publisher = peer.node("peer").publisher("n", number)
    first = bridge("ros2", "--both", f"n:{NUMBER}")
    publish_until_added(publisher, board[N], 1)
    first.end(signal.SIGKILL)
    assert peer.wait_graph(lambda graph: "/llfsm_bridge" not in graph.nodes, PATIENCE_S)
    board.add_message(N, Int64(2))  # nobody is there to send it, and it is old when somebody is
    bridge("ros2", "--both", f"n:{NUMBER}")
    assert peer.wait_graph(lambda graph: len(graph.ends("/n", Role.PUBLISHER)) == 2, PATIENCE_S)
    peer.node("listener").subscription("n", number, lambda a: received(a.decode().data))
    publish_until_added(publisher, board[N], 3)
    # A 3 that arrives only now may take the place of a 4 before that is sent.
    wait_for(lambda: 4 in received, between=lambda: board.add_message(N, Int64(4)))
    assert 2 not in received


@pytest.fixture
def stranger(router):
    """Open a Zenoh session that may say anything."""
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([router]))
    config.insert_json5("scouting/multicast/enabled", "false")
    with zenoh.open(config) as session:
        yield session


def test_nonsense_on_a_topic_is_reported_once_and_the_next_message_is_added(
    bridge, board, stranger, domain, types, peer
):
    text = types.message(TEXT)
    process = bridge("ros2", "--from-ros", f"s:{TEXT}")
    assert peer.wait_graph(lambda graph: bool(graph.ends("/s", Role.SUBSCRIPTION)), PATIENCE_S)
    key = data_key(domain, "/s", text.dds_name, text.type_hash)
    good = text.encode(String("whole"))
    dice = random.Random(1)
    nonsense = [good[:cut] for cut in range(len(good))]
    nonsense += [dice.randbytes(dice.randrange(200)) for _ in range(200)]
    for number, data in enumerate(nonsense, 1):
        stranger.put(key, data, attachment=pack(number, time.time_ns(), b"s" * 16))
    slot = board[Slot("s", String)]
    process.says("/s: ")

    def put_whole():
        stranger.put(key, good, attachment=pack(1, time.time_ns(), b"s" * 16))
        slot.wait(after=slot.count, timeout=0.05)

    wait_for(lambda: slot.get() == String("whole"), "the whole one", between=put_whole)
    assert process.end() == 0
    assert sum("/s: slot s" in line for line in process.printed) == 1


def test_another_type_on_a_topic_is_reported_once_and_the_right_one_is_added(
    bridge, board, peer, types, number
):
    process = bridge("ros2", "--from-ros", f"n:{NUMBER}")
    text = peer.node("wrong").publisher("n", types.message(TEXT))
    line = process.says("/wrong")
    assert TEXT in line
    assert NUMBER in line
    for _ in range(10):
        text.publish(String("x"))
    publish_until_added(peer.node("right").publisher("n", number), board[N], 5)
    assert process.end() == 0
    assert sum("/wrong" in line for line in process.printed) == 1


def test_another_version_of_a_type_is_reported(bridge, peer, tmp_path):
    from llfsm.bridges.ros2.types import TypeLibrary

    folder = tmp_path / "std_msgs" / "msg"
    folder.mkdir(parents=True)
    (folder / "Int64.msg").write_text("int64 data\nint64 more\n")
    other = TypeLibrary(share=[tmp_path]).message(NUMBER)
    process = bridge("ros2", "--from-ros", f"n:{NUMBER}")
    peer.node("old").publisher("n", other)
    assert "another definition" in process.says("/old")
    assert process.end() == 0
