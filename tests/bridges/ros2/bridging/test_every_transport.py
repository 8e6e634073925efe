"""What a bridge does, whatever carries it."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest

from llfsm.bridges.ros2.bridging import service_slots
from llfsm.bridges.ros2.bridging.bridge import Bridge
from llfsm.bridges.ros2.bridging.bridge_config import BridgeConfig
from llfsm.bridges.ros2.bridging.bridge_plan import make_plan
from llfsm.bridges.ros2.graph import Role
from llfsm.whiteboard import Slot
from llfsm.whiteboard.messages.std_msgs import Int64
from waiting import PATIENCE_S, wait_for

N = Slot("n", Int64)


@pytest.fixture
def bridge(world, board):
    """Run a bridge on a transport of this kind; ends with the test."""
    running = []

    def start(**config):
        plan, faults = make_plan(msgspec.convert(config, BridgeConfig), Path(), [])
        assert not faults
        running.append(Bridge(plan, board, world.open()))

    yield start
    for each in running:
        each.close()


def test_both_directions_without_an_echo(bridge, board, world, types, seen):
    number, peer, received = types.message("std_msgs/msg/Int64"), world.open(), seen()
    bridge(relay=[{"slot": "n", "type": number.name, "direction": "both", "depth": 10}])
    node = peer.node("peer")
    node.subscription("n", number, lambda a: received(a.decode().data))
    talker = node.publisher("n", number)
    assert peer.wait_graph(
        lambda graph: all(
            len(graph.ends("/n", role)) == 2 for role in (Role.PUBLISHER, Role.SUBSCRIPTION)
        ),
        PATIENCE_S,
    )
    world.meet("/n", 2)
    slot = board[N]
    slot.add(Int64(1))
    received.wait(lambda got: 1 in got)
    talker.publish(Int64(2))
    wait_for(lambda: slot.get() == Int64(2))
    slot.add(Int64(3))
    received.wait(lambda got: 3 in got)
    talker.publish(Int64(4))
    wait_for(lambda: slot.get() == Int64(4))
    assert received[:3] == [1, 2, 3]
    assert slot.count == 4


def test_services_through_slots_on_both_ends(bridge, board, world, types):
    """From a slot to ROS and back to a slot, by two bridges."""
    name = "turtlesim/srv/Spawn"
    of = types.service(name)
    bridge(node="server", server=[{"service": "s", "type": name, "slots": "serving"}])
    bridge(node="client", client=[{"service": "s", "type": name, "slots": "asking"}])
    witness = world.open()
    assert witness.wait_graph(lambda graph: bool(graph.ends("/s", Role.SERVER)), PATIENCE_S)
    asking, serving = service_slots("asking", of), service_slots("serving", of)
    answers, requests = board[asking.answer], board[serving.request]
    number, request = 0, None
    while request is None:  # until the client knows of the server
        number += 1
        seen = answers.count
        board.add_message(asking.request, asking.request.type(number, name="bob"))
        request = requests.wait(after=0, timeout=0.2)
        if request is None:
            assert answers.wait(after=seen, timeout=PATIENCE_S) is not None
    assert request.message.name == "bob"
    seen = answers.count
    board.add_message(serving.answer, serving.answer.type(request.message.number, "bob"))
    answer = answers.wait(after=seen, timeout=PATIENCE_S)
    assert answer is not None
    assert (answer.message.number, answer.message.name) == (number, "bob")


WAITED_FOR = {  # by ros2cli's client of parameters, 5 s for each node, before it lists one
    "get_parameters": "GetParameters",
    "set_parameters": "SetParameters",
    "list_parameters": "ListParameters",
    "describe_parameters": "DescribeParameters",
    "get_parameter_types": "GetParameterTypes",
    "set_parameters_atomically": "SetParametersAtomically",
}


def test_every_node_has_the_services_that_ros2_param_waits_for(bridge, world, types):
    bridge(
        relay=[{"slot": "n", "type": "std_msgs/msg/Int64", "direction": "both"}],
        turtle_position={"pose": "pose"},
    )
    transport = world.open()
    ours = {"/llfsm_bridge", "/turtle_sensor_poster"}
    assert transport.wait_graph(lambda graph: ours <= set(graph.nodes), PATIENCE_S)
    tool = transport.node("tool")
    for node in set(transport.graph().nodes) - {"/tool"}:
        clients = {
            name: tool.client(f"{node}/{name}", types.service(f"rcl_interfaces/srv/{kind}"))
            for name, kind in WAITED_FOR.items()
        }
        assert transport.wait_graph(
            lambda _, c=clients: all(o.ready for o in c.values()), PATIENCE_S
        )
        request = types.service("rcl_interfaces/srv/ListParameters").request.message()
        names = (
            clients["list_parameters"]
            .call(request, timeout=PATIENCE_S)
            .result(PATIENCE_S)
            .result.names
        )
        assert "use_sim_time" in names
