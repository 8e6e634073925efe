"""`llfsm bridge` as a process, over Zenoh."""

from __future__ import annotations

import re
import signal

import pytest

from llfsm.bridges.ros2.graph import Role
from llfsm.whiteboard import Slot
from llfsm.whiteboard.messages.geometry_msgs import Twist, Vector3
from llfsm.whiteboard.messages.std_msgs import String
from llfsm.whiteboard.messages.turtle_sensor_poster import REQUEST
from llfsm.whiteboard.messages.turtlesim import Pose
from waiting import PATIENCE_S

TEXT = "std_msgs/msg/String"
CMD_VEL = Slot("turtle1/cmd_vel", Twist)
POSE = Slot("turtle1/pose", Pose)


@pytest.fixture
def text(types):
    return types.message(TEXT)


@pytest.fixture
def hear(peer, seen):
    """Subscribe to a topic, and wait until its publisher is known."""

    def hearing(topic, of):
        got = seen()
        peer.node("listener").subscription(topic, of, lambda a: got(a.decode()))
        assert peer.wait_graph(lambda graph: bool(graph.ends(topic, Role.PUBLISHER)), PATIENCE_S)
        return got

    return hearing


@pytest.fixture
def simulator(run, domain, router):
    """Start turtlesim as a node of ROS."""

    def start(at=router):
        where = ("--ros", "--transport", "zenoh", "--domain", str(domain), "--router", at)
        return run("turtlesim", *where)

    return start


def test_flags_connect_slots_with_topics(bridge, board, peer, text, hear):
    process = bridge("ros2", "--to-ros", f"out:{TEXT}", "--from-ros", f"in:{TEXT}")
    received = hear("/out", text)
    received.repeat(lambda: board.add_message(Slot("out", String), String("hello")))
    assert received[0] == String("hello")
    publisher = peer.node("talker").publisher("in", text)
    slot = board[Slot("in", String)]
    assert peer.wait_graph(lambda graph: len(graph.ends("/in", Role.SUBSCRIPTION)) == 1, PATIENCE_S)
    publisher.publish(String("there"))
    sample = slot.wait(after=0, timeout=PATIENCE_S)
    assert sample is not None
    assert sample.message == String("there")
    assert process.end() == 0
    assert peer.wait_graph(lambda graph: "/llfsm_bridge" not in graph.nodes, PATIENCE_S)
    printed = "".join(process.printed)
    assert re.search("out -> /out: [1-9]", printed)
    assert "in <- /in: 1, " in printed


def test_a_file_connects_them_likewise_and_quietly(bridge, board, tmp_path, text, hear):
    file = tmp_path / "bridge.toml"
    file.write_text(
        f'[[relay]]\nslot = "say"\ntopic = "/said"\ntype = "{TEXT}"\ndirection = "to_ros"\n'
    )
    process = bridge("ros2", "--config", str(file), "--quiet")
    received = hear("/said", text)
    received.repeat(lambda: board.add_message(Slot("say", String), String("hello")))
    assert process.end(signal.SIGINT) == 0
    assert len(process.printed) == 1  # where it was


def test_a_bridge_ends_with_its_whiteboard(bridge, board, peer, met):
    process = bridge("turtlesim")
    met("/llfsm_turtlesim_bridge", "/turtle_sensor_poster")
    board.remove()
    assert process.process.wait(PATIENCE_S) == 75  # the board is gone
    assert peer.wait_graph(lambda graph: not graph.nodes, PATIENCE_S)


def test_a_command_to_stop_gets_through_at_the_end(bridge, run, board, types, hear):
    """All are asked to end at once, the bridge twice, and the machine takes its time."""
    process = bridge("turtlesim")
    received = hear("/turtle1/cmd_vel", types.message("geometry_msgs/msg/Twist"))
    machine = run("run", "RosBlindTurttleBot", "--board", board.name, "-v")
    received.wait(lambda got: got[-1:] == [Twist(linear=Vector3(x=2.0))])
    machine.process.send_signal(signal.SIGSTOP)
    process.process.send_signal(signal.SIGTERM)
    process.process.send_signal(signal.SIGINT)
    machine.process.send_signal(signal.SIGTERM)
    machine.process.send_signal(signal.SIGCONT)
    received.wait(lambda got: got[-1] == Twist())
    assert process.process.wait(PATIENCE_S) == 0


def test_the_wall_machine_drives_the_turtle_of_a_node(bridge, run, simulator, board):
    """As it is, in a process of its own, beside a simulator that it shares no board with."""
    bridge("turtlesim")
    simulator()
    pose = board[POSE].wait(after=0, timeout=PATIENCE_S)
    assert pose is not None
    machine = run("run", "RosWallTurttleBot", "--board", board.name, "-v")
    for state in ("STRAIGHT", "STOP", "TEST", "STRAIGHT"):
        machine.says(f"- {state}")
    moved = board.get_message(POSE)
    assert moved is not None
    assert moved.x > pose.message.x + 1
    assert board.get_message(REQUEST) is not None
    assert machine.end() == 0
    stopped = board[POSE].count
    after = board[POSE].wait(after=stopped + 10, timeout=PATIENCE_S)
    while after is not None and after.message.linear_velocity:
        after = board[POSE].wait(after=after.count, timeout=PATIENCE_S)
    assert after is not None
