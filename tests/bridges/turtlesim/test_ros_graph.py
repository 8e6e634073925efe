"""What ROS's tools see of our node is what they see of turtlesim 1.8.2."""

from __future__ import annotations

import pytest

from llfsm.bridges.ros2.graph import Role

SECTIONS = {
    "turtlesim_publishers": Role.PUBLISHER,
    "turtlesim_subscriptions": Role.SUBSCRIPTION,
    "turtlesim_services": Role.SERVER,
}


def ours(ros):
    return [end for end in ros.transport.graph().endpoints if end.node == "/turtlesim"]


def test_every_endpoint_is_there_and_no_other(ros, recorded):
    graph = recorded("graph.json")
    for section, role in SECTIONS.items():
        seen = {end.name: [end.type_name] for end in ours(ros) if end.role is role}
        assert seen == graph[section]


def test_qos_and_hashes_are_those_of_the_real_node(ros, recorded):
    for topic, ends in recorded("graph.json")["qos"].items():
        for section, role in (("publishers", Role.PUBLISHER), ("subscriptions", Role.SUBSCRIPTION)):
            expected = [
                (end["type_hash"], end["reliability"], end["durability"], end["depth"])
                for end in ends[section]
                if end["node"] == "turtlesim"
            ]
            seen = [
                (end.type_hash, end.qos.reliability.name, end.qos.durability.name, end.qos.depth)
                for end in ours(ros)
                if end.name == topic and end.role is role
            ]
            assert sorted(seen) == sorted(expected), topic


def names(ros, turtle):
    return {end.name for end in ours(ros) if end.name.startswith(f"/{turtle}/")}


def test_a_spawned_turtle_has_all_that_turtle1_has_until_it_is_killed(ros):
    ros.call("/spawn", "turtlesim/srv/Spawn", name="bob")
    assert names(ros, "bob") == {
        name.replace("turtle1", "bob", 1) for name in names(ros, "turtle1")
    }
    ros.call("/kill", "turtlesim/srv/Kill", name="bob")
    assert not names(ros, "bob")
    assert names(ros, "turtle1")
    ros.step()


def test_an_illegal_name_leaves_the_graph_as_it_was(ros):
    before = ours(ros)
    answer = ros.call("/spawn", "turtlesim/srv/Spawn", name="bad name!")
    assert answer.name == ""
    assert ours(ros) == before
    ros.step()


@pytest.mark.parametrize("ros", ["memory", "zenoh"], indirect=True)
def test_nothing_on_the_graph_is_reported_as_a_fault(ros):
    """The node publishes its parameters' events, and subscribes to them with two QoS profiles."""
    events = ros.hear("/parameter_events", "rcl_interfaces/msg/ParameterEvent")
    ros.call("/reset", "std_srvs/srv/Empty")
    ros.step()
    assert not events
    assert not ros.reported
