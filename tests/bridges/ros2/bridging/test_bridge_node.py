"""A bridge is a node like others: its relays are set by parameters, and its health is published."""

from __future__ import annotations

import logging
import os
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace

import pytest
from msgspec.structs import replace

from llfsm.bridges.ros2.bridging.bridge import Bridge, BridgeHealth, HealthLevel
from llfsm.bridges.ros2.bridging.bridge_config import BridgeConfig, RelayConfig
from llfsm.bridges.ros2.bridging.bridge_plan import make_plan
from llfsm.bridges.ros2.bridging.link import BridgeLink
from llfsm.bridges.ros2.errors import ParameterOverrideError
from llfsm.bridges.ros2.graph import Role
from llfsm.bridges.ros2.qos import DurabilityPolicy, LivelinessPolicy, Qos
from llfsm.bridges.ros2.ros_arguments import split_ros_arguments
from llfsm.bridges.ros2.transport import Notifier
from llfsm.whiteboard import Slot
from llfsm.whiteboard.liveness import born, host_name, pid_namespace
from llfsm.whiteboard.messages.llfsm import MachineStatus, status_slot
from llfsm.whiteboard.messages.std_msgs import Int64
from memory_transport import MemoryTransport
from waiting import PATIENCE_S

N = Slot("n", Int64)
RELAY = {"slot": "n", "type": "std_msgs/msg/Int64", "direction": "to_ros"}


@pytest.fixture
def call(peer, types):
    """Call a service of the bridge's node."""
    node = peer.node("tool")

    def call(name, bridge="/llfsm_bridge", **fields):
        kind = "".join(map(str.capitalize, name.split("_")))
        of = types.service(f"rcl_interfaces/srv/{kind}")
        client = node.client(f"{bridge}/{name}", of)
        return client.call(of.request.message(**fields), timeout=PATIENCE_S).result(PATIENCE_S)

    return call


def wanted(types, name, **value):
    held = types.message("rcl_interfaces/msg/ParameterValue").message(**value)
    return (types.message("rcl_interfaces/msg/Parameter").message(name=name, value=held),)


@pytest.mark.parametrize(("switches", "passed"), [((False,), []), ((False, True), [1])])
def test_a_relay_is_switched_off_and_on(start, board, peer, types, seen, call, switches, passed):
    got = seen()
    number, node = types.message("std_msgs/msg/Int64"), peer.node("peer")
    node.subscription("n", number, lambda a: got(a.decode().data), Qos(depth=100))
    bridge = start(relay=[RELAY])
    for enabled in switches:
        parameter = wanted(types, "relays./n.enabled", type=1, bool_value=enabled)
        assert call("set_parameters", parameters=parameter).results[0].successful
    board[N].add(Int64(1))
    bridge.close()  # after publishing what is on the slot
    node.publisher("n", number).publish(number.message(data=2))
    got.wait(lambda got: 2 in got)
    assert got == [*passed, 2]


def test_a_rate_is_set_within_its_range(start, types, call):
    start(relay=[RELAY | {"rate": 4}])

    def rate():
        (value,) = call("get_parameters", names=("relays./n.rate",)).values
        return value.double_value

    assert rate() == 4.0
    for wished, found in ((10.0, 10.0), (0.0, 0.0), (-1.0, 0.0)):
        parameter = wanted(types, "relays./n.rate", type=3, double_value=wished)
        result = call("set_parameters", parameters=parameter).results[0]
        assert (result.successful, rate()) == (wished == found, found)


def test_relays_of_one_topic_have_parameters_of_their_own(start, call):
    start(relay=[RELAY, RELAY | {"slot": "m", "topic": "n"}])
    names = call("list_parameters", prefixes=("relays",)).result.names
    assert sorted(names) == sorted(
        f"relays./n.{slot}.{what}" for slot in "mn" for what in ("enabled", "rate")
    )


def planned(*arguments):
    _, ros = split_ros_arguments(["--ros-args", *arguments])
    config = BridgeConfig(relay=(RelayConfig(**RELAY),))
    return make_plan(config, None, [], ros)


def test_arguments_rename_remap_and_set(board, memory, peer, reported, call):
    plan, faults = planned(
        "-r", "__ns:=/robot", "-r", "__node:=link", "-r", "n:=/m", "-p", "relays./m.rate:=5.0"
    )
    assert not faults
    with MemoryTransport(memory, notify=reported) as transport:
        bridge = Bridge(plan, board, transport, reported)
        try:
            graph = peer.graph()
            assert "/robot/link" in graph.nodes
            assert "/m" in graph.topics()
            assert "/robot/link/get_parameters" in graph.services()
            assert str(bridge.links[0]) == "n -> /m"
            (rate,) = call("get_parameters", "/robot/link", names=("relays./m.rate",)).values
            assert rate.double_value == 5.0
        finally:
            bridge.close()


def test_an_argument_of_the_wrong_type_ends_it(board, memory, peer, reported):
    plan, _ = planned("-p", "relays./n.rate:=fast")
    with (
        MemoryTransport(memory, notify=reported) as transport,
        pytest.raises(ParameterOverrideError, match=r"relays\./n\.rate"),
    ):
        Bridge(plan, board, transport, reported)
    assert peer.graph().nodes == ()


def test_what_is_logged_appears_on_rosout(start, peer, types, seen):
    got = seen()
    line = types.message("rcl_interfaces/msg/Log")
    late = Qos(durability=DurabilityPolicy.TRANSIENT_LOCAL, depth=100)
    peer.node("tool").subscription("/rosout", line, lambda a: got(a.decode()), late)
    bridge = start(relay=[RELAY])
    logger = logging.Logger("any")
    logger.addHandler(bridge.log)
    logger.warning("n is bad")
    got.wait(len)
    assert [(each.name, each.msg, each.level) for each in got] == [("llfsm_bridge", "n is bad", 30)]


def test_health_is_published(start, peer, types, seen):
    got = seen()
    array = types.message("diagnostic_msgs/msg/DiagnosticArray")
    peer.node("tool").subscription("/diagnostics", array, lambda a: got(a.decode()))
    start(relay=[RELAY])
    got.wait(len)
    (status,) = got[0].status
    assert (status.name, status.level) == ("llfsm_bridge: n -> /n", 0)
    assert got[0].header.stamp.sec > 1_600_000_000


def test_a_links_health_has_its_rate_its_age_and_what_it_lost(board):
    now = [0.0]
    link = BridgeLink("n", "<-", "/n", "std_msgs/msg/Int64", Notifier(print))
    health = BridgeHealth([link], board, now=lambda: now[0])
    for _ in range(10):
        link.count()
    now[0] = 2.0
    (good,) = health.report()
    assert (good.name, good.level, good.values["rate (Hz)"]) == ("n <- /n", HealthLevel.OK, "5.0")
    assert float(good.values["age (s)"]) >= 0
    link.failed += 3
    now[0] = 3.0
    (losing,) = health.report()
    assert (losing.level, losing.message) == (HealthLevel.WARN, "3 lost since the last report")
    assert (losing.values["rate (Hz)"], losing.values["lost"]) == ("0.0", "3")
    assert health.report()[0].level is HealthLevel.OK
    link.end = SimpleNamespace(broken=2)
    link.failed += 1
    (late,) = health.report()
    assert (late.level, late.values["too late"]) == (HealthLevel.WARN, "2")
    assert late.message == "1 lost, 2 too late since the last report"


def test_a_machines_health_is_its_published_status(board):
    health = BridgeHealth([], board)
    now = MachineStatus(
        state="well", pid=os.getpid(), born=born(os.getpid()), host=host_name(),
        namespace=pid_namespace(), overruns=2,
    )  # fmt: skip
    board.add_message(status_slot("M"), now)
    (well,) = health.report()
    assert (well.name, well.level, well.message) == ("machine M", HealthLevel.OK, "running")
    assert (well.values["state"], well.values["overruns"]) == ("well", "2")
    board.add_message(status_slot("M"), replace(now, failed=True, error="ValueError: gone"))
    (failed,) = health.report()
    assert (failed.level, failed.message) == (HealthLevel.ERROR, "failed: ValueError: gone")


def test_the_qos_of_a_relay_is_configured_and_overridden_by_parameters(board, memory):
    relay = RelayConfig(**RELAY, deadline=0.5, lifespan=2, lease=1, liveliness="manual_by_topic")
    _, arguments = split_ros_arguments(
        ["--ros-args", "-p", "qos_overrides./n.publisher.deadline:=7"]
    )
    plan, faults = make_plan(BridgeConfig(relay=(relay,)), Path(), [], arguments)
    assert not faults
    with MemoryTransport(memory) as transport, closing(Bridge(plan, board, transport)):
        (end,) = transport.graph().ends("/n", Role.PUBLISHER)
    assert end.qos == Qos(
        deadline_ns=7,
        lifespan_ns=2 * 10**9,
        liveliness=LivelinessPolicy.MANUAL_BY_TOPIC,
        lease_ns=10**9,
    )
