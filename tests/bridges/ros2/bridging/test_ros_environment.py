"""Machines in the process of their bridge: sensors and actuators on topics."""

from __future__ import annotations

import logging
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from llfsm.bridges.ros2.bridging.bridge_config import BridgeConfig, RelayConfig
from llfsm.bridges.ros2.bridging.bridge_plan import make_plan
from llfsm.bridges.ros2.bridging.machine_config import machine_config, plan_for
from llfsm.bridges.ros2.bridging.ros_environment import RosEnvironment
from llfsm.bridges.ros2.qos import Qos
from llfsm.machines.wall_turtle import RosWallTurttleBot
from llfsm.runtime import Actuator, Arrangement, Machine, Sensor, State
from llfsm.runtime.engine.errors import ConfigurationError
from llfsm.whiteboard import Message, Slot
from llfsm.whiteboard.messages.std_msgs import Int64, String
from memory_transport import MemoryTransport
from waiting import PATIENCE_S

TYPE = "std_msgs/msg/Int64"


class Inner(Message):
    """No type of ROS."""

    n: int = 0


class Doubler(Machine):
    """Post twice what it reads, until that is 0; safe is -1."""

    n = Sensor(Slot("n", Int64), default=Int64(-1))
    twice = Actuator(Slot("twice", Int64), at_end=Int64(-1))
    inner = Actuator(Slot("inner", Inner))
    odd_name = Actuator(Slot("odd-name", String))

    waiting = State()
    posting = State()
    over = State()

    waiting.to(over, when=lambda self: self.n.data == 0)
    waiting.to(posting, when=lambda self: self.n.data > 0)

    @posting.on_entry
    def _(self) -> None:
        logging.getLogger("doubler").warning("twice %d", self.n.data)
        self.twice(Int64(2 * self.n.data))

    posting.to(over, when=lambda self: self.n.data == 0)


@pytest.fixture
def transport(memory, reported):
    with MemoryTransport(memory, notify=reported) as transport:
        yield transport


def test_a_machine_is_a_node_and_its_slots_are_topics(transport, peer, types, seen):
    got, lines = seen(), seen()
    node = peer.node("peer")
    number = types.message(TYPE)
    node.subscription("robot/twice", number, lambda a: got(a.decode().data), Qos(depth=10))
    node.subscription(
        "/rosout", types.message("rcl_interfaces/msg/Log"), lambda a: lines(a.decode())
    )
    publisher = node.publisher("robot/n", number)
    with RosEnvironment(transport, plan_for(Doubler, node="robot/doubler")) as environment:
        arrangement = Arrangement([Doubler], environment=environment)
        running = threading.Thread(target=arrangement.run)
        running.start()
        assert "/robot/doubler" in peer.graph().nodes
        publisher.publish(number.message(21))
        got.wait(lambda got: 42 in got)
        publisher.publish(number.message(0))
        running.join(PATIENCE_S)
        assert not running.is_alive()
    assert got == [42, -1]  # the safe value of the end, too
    lines.wait(lambda lines: any(line.msg == "twice 21" for line in lines))
    assert "/robot/doubler" not in peer.graph().nodes
    assert not environment.whiteboard.alive
    assert environment.bridge.log not in logging.getLogger().handlers


def test_it_waits_for_a_subscription_of_another_node_to_each_topic(transport, peer, types):
    number = types.message(TYPE)
    plan, faults = make_plan(
        BridgeConfig(
            relay=(
                RelayConfig(slot="both", type=TYPE, direction="both"),
                RelayConfig(slot="out", type=TYPE, direction="to_ros"),
                RelayConfig(slot="in", type=TYPE, direction="from_ros"),
            )
        ),
        Path(),
        [],
    )
    assert not faults
    with RosEnvironment(transport, plan) as environment:
        node = peer.node("peer")
        node.subscription("out", number, lambda _: None)
        assert not environment.wait_subscribed(0.01)  # its own subscription to "both" is none
        waiting = ThreadPoolExecutor(1).submit(environment.wait_subscribed, PATIENCE_S)
        node.subscription("both", number, lambda _: None)
        assert waiting.result()


def test_topics_are_named_by_the_slots_of_ros_types():
    config = machine_config([(Doubler, {"twice": "n2", "n": "left/n"})])
    assert {(relay.slot, relay.type, relay.direction) for relay in config.relay} == {
        ("left/n", TYPE, "from_ros"),
        ("n2", TYPE, "to_ros"),
    }
    assert config.turtle_position is None


def test_a_slot_between_machines_goes_both_ways():
    class Reader(Machine):
        n = Sensor(Slot("twice", Int64))
        only = State()

    config = machine_config([(Doubler, {}), (Reader, {})])
    assert {relay.slot: relay.direction for relay in config.relay} == {
        "n": "from_ros",
        "twice": "both",
    }


def test_the_position_of_a_turtle_is_answered_from_its_pose():
    config = machine_config([(RosWallTurttleBot, {"turtle1/cmd_vel": "bob/cmd_vel"})])
    assert config.turtle_position.pose == "bob/pose"
    assert {relay.slot for relay in config.relay} == {"bob/pose", "bob/cmd_vel"}


def test_a_name_that_no_node_can_have_is_an_error():
    with pytest.raises(ConfigurationError, match="not a node name"):
        plan_for(Doubler, node="a b")


def test_a_board_may_be_shared(transport, board):
    with RosEnvironment(transport, plan_for(Doubler), board=board) as environment:
        Arrangement([Doubler], environment=environment).round()
        assert {slot.name for slot in board.slots()} >= {"n", "twice"}
    assert board.alive
