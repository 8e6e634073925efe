"""What every transport tells of the graph."""

from __future__ import annotations

import pytest

from llfsm.bridges.ros2.graph import Role
from llfsm.bridges.ros2.qos import DurabilityPolicy, Qos, ReliabilityPolicy
from llfsm.bridges.ros2.transport import NoticeKind
from waiting import PATIENCE_S


@pytest.fixture
def populated(world, types):
    """Return a transport that sees a node with an endpoint of each kind, and these."""
    node = world.open().node("there", "/ns")
    pose, spawn = types.message("turtlesim/msg/Pose"), types.service("turtlesim/srv/Spawn")
    kept = Qos(ReliabilityPolicy.RELIABLE, DurabilityPolicy.TRANSIENT_LOCAL, depth=3)
    ends = {
        "/pose": node.publisher("/pose", pose, kept),
        "/ns/there/cmd": node.subscription(
            "~/cmd", pose, print, Qos(ReliabilityPolicy.BEST_EFFORT)
        ),
        "/ns/spawn": node.server("spawn", spawn, print),
        "/kill": node.client("/kill", spawn),
    }
    transport = world.open()
    assert transport.wait_graph(lambda graph: len(graph.endpoints) == 4 and graph.nodes, PATIENCE_S)
    return transport, node, ends


def test_the_graph_reports_nodes_and_endpoints_with_type_and_qos(populated, types, world):
    transport, _, _ = populated
    graph = transport.graph()
    assert graph.nodes == ("/ns/there",)
    assert {(end.name, end.role): (end.type_name, end.node) for end in graph.endpoints} == {
        ("/pose", Role.PUBLISHER): ("turtlesim/msg/Pose", "/ns/there"),
        ("/ns/there/cmd", Role.SUBSCRIPTION): ("turtlesim/msg/Pose", "/ns/there"),
        ("/ns/spawn", Role.SERVER): ("turtlesim/srv/Spawn", "/ns/there"),
        ("/kill", Role.CLIENT): ("turtlesim/srv/Spawn", "/ns/there"),
    }
    (publisher,) = graph.ends("/pose", Role.PUBLISHER)
    assert publisher.type_hash == types.message("turtlesim/msg/Pose").type_hash
    depth = 3 if world.reports_depth else Qos().depth
    assert publisher.qos == Qos(
        ReliabilityPolicy.RELIABLE, DurabilityPolicy.TRANSIENT_LOCAL, depth=depth
    )
    (subscription,) = graph.ends("/ns/there/cmd", Role.SUBSCRIPTION)
    assert subscription.qos is not None
    assert subscription.qos.reliability is ReliabilityPolicy.BEST_EFFORT
    topics = graph.topics()
    assert topics == {
        "/ns/there/cmd": ("turtlesim/msg/Pose",),
        "/pose": ("turtlesim/msg/Pose",),
    }
    assert graph.services() == {"/ns/spawn": ("turtlesim/srv/Spawn",)}


@pytest.mark.parametrize("name", ["/pose", "/ns/there/cmd", "/ns/spawn", "/kill"])
def test_an_endpoint_that_is_closed_is_gone_and_the_others_are_not(populated, name, world):
    transport, _, ends = populated
    ends.pop(name).close()
    assert transport.wait_graph(
        lambda graph: {end.name for end in graph.endpoints} == set(ends), PATIENCE_S
    ), transport.graph()
    assert transport.graph().nodes == ("/ns/there",)


def test_a_node_that_is_closed_takes_its_endpoints_along(populated, world):
    transport, node, ends = populated
    node.close()
    assert all(end.closed for end in ends.values())
    assert transport.wait_graph(lambda graph: not graph.nodes and not graph.endpoints, PATIENCE_S)


def test_a_transport_that_is_closed_leaves_no_ghost(world, types):
    one, two = world.open(), world.open()
    one.node("there").publisher("a", types.message("turtlesim/msg/Pose"))
    assert two.wait_graph(lambda graph: bool(graph.nodes and graph.endpoints), PATIENCE_S)
    one.close()
    assert one.closed
    assert two.wait_graph(lambda graph: not graph.nodes and not graph.endpoints, PATIENCE_S)


def test_a_transport_that_is_open_is_up_and_sees_itself(world):
    transport = world.open()
    assert transport.up
    transport.node("me")
    assert transport.wait_graph(lambda graph: graph.nodes == ("/me",), PATIENCE_S)


def test_two_nodes_may_have_one_name(world):
    one, two = world.open(), world.open()
    one.node("twin")
    two.node("twin")
    assert one.wait_graph(lambda graph: graph.nodes == ("/twin", "/twin"), PATIENCE_S)


def test_a_hidden_node_is_not_listed_and_its_endpoints_are(world, types, seen):
    reported = seen()
    one, two = world.open(), world.open(reported)
    node = one.node("_ros2cli_1")
    node.publisher("a", types.message("turtlesim/msg/Pose"))
    node.server("s", types.service("turtlesim/srv/Spawn"), print)
    two.node("shown").subscription("a", types.message("std_msgs/msg/Int64"), print)
    assert two.wait_graph(lambda graph: len(graph.endpoints) == 3, PATIENCE_S)
    assert two.graph().nodes == ("/shown",)
    assert {end.node for end in two.graph().endpoints} == {"/_ros2cli_1", "/shown"}
    reported.wait(len)
    assert [(notice.kind, notice.name) for notice in reported] == [(NoticeKind.TYPE_MISMATCH, "/a")]


def test_waiting_for_the_graph_ends_when_the_time_has_passed(world):
    assert world.open().wait_graph(lambda _: False, 0.01) is False
