"""`llfsm run --ros`: machines that are a node, in one process."""

from __future__ import annotations

import os
import signal
import threading
from contextlib import contextmanager
from functools import partial

import pytest

from calling import call
from llfsm.bridges.ros2.bridging.managed_machines import ManagedMachines
from llfsm.bridges.ros2.bridging.ros_environment import RosEnvironment
from llfsm.bridges.ros2.qos import Qos

TYPE = "std_msgs/msg/Int64"

COUNTER = """
from llfsm.runtime import Actuator, Machine, Sensor, State
from llfsm.whiteboard import Slot
from llfsm.whiteboard.messages.std_msgs import Int64

class Counter(Machine):
    n = Sensor(Slot("n", Int64), default=Int64())
    twice = Actuator(Slot("twice", Int64), at_end=Int64(-1))
    waiting = State()
    over = State()

    waiting.to(over, when=lambda self: self.n.data > 0)

    @over.on_entry
    def _(self) -> None:
        self.twice(Int64(2 * self.n.data))
"""


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "counter.py").write_text(COUNTER)
    return tmp_path


@contextmanager
def publishing(peer, topic, message):
    """Publish a message again and again: whoever subscribes later gets it, too."""
    over, publisher = threading.Event(), peer.node("talker").publisher(topic, message)

    def publish():
        while not over.wait(0.02):
            publisher.publish(message.message(21))

    thread = threading.Thread(target=publish)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


@pytest.fixture
def run_ros(folder, domain, router):
    at = ("--domain", str(domain), "--router", router, "--transport", "zenoh")

    def run(arguments):
        return call("run", "--ros", "counter.py:Counter", *at, *arguments.split(), cwd=folder)

    return run


@pytest.mark.parametrize(("more", "waits"), [("", 1), (" --lifecycle", 0)])
def test_machines_wait_for_subscriptions_unless_they_are_managed(
    run_ros, peer, types, monkeypatch, more, waits
):
    waited = []
    monkeypatch.setattr(RosEnvironment, "wait_subscribed", lambda _: waited.append(1))
    monkeypatch.setattr(ManagedMachines, "run", lambda _: None)
    with publishing(peer, "/n", types.message(TYPE)):
        done = run_ros(f"-q{more}")
    assert done.returncode == 0, done.stderr
    assert len(waited) == waits


def test_an_interrupt_while_they_wait_ends_as_one_of_a_run_does(run_ros, monkeypatch):
    interrupt = partial(os.kill, os.getpid(), signal.SIGINT)
    monkeypatch.setattr(RosEnvironment, "wait_subscribed", lambda _: interrupt())
    done = run_ros("-v")
    assert done.returncode == 0, done.stderr
    assert "Counter" not in done.stderr


def test_a_run_is_a_node_without_a_whiteboard(run_ros, peer, domain, types, seen):
    got, number = seen(), types.message(TYPE)
    peer.node("listener").subscription(
        "/robot/twice", number, lambda a: got(a.decode().data), Qos(depth=9)
    )
    with publishing(peer, "/robot/n", number):
        done = run_ros("-v --ros-args -r __ns:=/robot -r __node:=counter")
    assert done.returncode == 0, done.stderr
    assert f": Counter on ROS domain {domain} as /robot/counter\n" in done.stderr
    assert "- over" in done.stderr
    got.wait(lambda got: got[-1] == -1)  # the safe value of the end; 42 may be replaced before


def test_a_configuration_names_the_topics(run_ros, folder, peer, types):
    (folder / "topics.toml").write_text(
        f'node = "wired"\n[[relay]]\nslot = "n"\ntopic = "/in"\ntype = "{TYPE}"\n'
        'direction = "from_ros"\n'
    )
    with publishing(peer, "/in", types.message(TYPE)):
        done = run_ros("--config topics.toml")
    assert done.returncode == 0, done.stderr
    assert "as /wired" in done.stderr


@pytest.mark.parametrize("more", ["", " --remove-board"])
def test_with_a_board_others_see_the_machine(run_ros, board, peer, types, seen, monkeypatch, more):
    got, number, closed = seen(), types.message(TYPE), []
    peer.node("listener").subscription(
        "/twice", number, lambda a: got(a.decode().data), Qos(depth=9)
    )

    def close(environment):  # as long as there is a board on which to look for the last message
        closed.append((board.path.exists(), bool(environment.whiteboard.slots())))
        published(environment)

    published = RosEnvironment.close
    monkeypatch.setattr(RosEnvironment, "close", close)
    with publishing(peer, "n", number):
        done = run_ros(f"--board {board.name} --node shown{more}")
    assert done.returncode == 0, done.stderr
    assert f"on whiteboard {board.name}, ROS domain" in done.stderr
    assert {"n", "twice"} <= {slot.name for slot in board.slots()}
    assert closed == [(True, True)]
    got.wait(lambda got: got[-1] == -1)


@pytest.mark.parametrize(
    ("arguments", "why"),
    [
        (["--ros", "-n"], "leave it out"),
        (["--ros", "--record", "x.mcap"], "add --board"),
        (["--config", "x.toml"], "--ros is needed for --config"),
        (["--node", "x"], "--ros is needed for --node"),
        (["--lifecycle"], "--ros is needed for --lifecycle"),
        (["--ros", "--lifecycle", "-b", "x", "--record", "x.mcap"], "may start several"),
        (["--ros-args", "-r", "__ns:=/x"], "--ros is needed for --ros-args"),
        (["--ros", "--node", "a b"], "not a node name"),
        (["--ros", "--config", "missing.toml"], "missing.toml"),
        (["--ros", "--ros-args", "-r", "oops"], "write [NODE:]FROM:=TO"),
    ],
)
def test_what_is_wrong_is_usage(folder, router, arguments, why):
    done = call("run", "counter.py:Counter", "--router", router, *arguments, cwd=folder)
    assert done.returncode == 2, done.stderr
    assert why in done.stderr


def test_a_configuration_that_is_wrong_is_reported_before_ros_is_looked_for(folder):
    nowhere = ["--transport", "zenoh", "--router", "tcp/127.0.0.1:1"]
    arguments = ["counter.py:Counter", "--ros", "--config", "missing.toml", *nowhere]
    done = call("run", *arguments, cwd=folder)
    assert done.returncode == 2
    assert done.stderr == "Error: missing.toml: cannot be read: No such file or directory\n"
