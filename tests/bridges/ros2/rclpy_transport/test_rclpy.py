"""What is particular to the transport on rclpy, with a stand-in for rclpy."""

from __future__ import annotations

import sys
from functools import partial
from types import ModuleType, SimpleNamespace

import pytest

from fake_rclpy.events import EventCallbacks
from fake_rclpy.world import CHANGED as NODES_CHANGED
from fake_rclpy.world import NODES, RCLError
from llfsm.bridges.ros2.errors import (
    CallTimeoutError,
    TransportClosedError,
    TransportUnavailableError,
)
from llfsm.bridges.ros2.graph import Role
from llfsm.bridges.ros2.opening import open_transport
from llfsm.bridges.ros2.qos import Qos
from llfsm.bridges.ros2.rclpy_transport.api import find_class, import_rclpy
from llfsm.bridges.ros2.rclpy_transport.context import RclpyContext
from llfsm.bridges.ros2.rclpy_transport.transport import RclpyTransport
from llfsm.bridges.ros2.transport import NoticeKind, Notifier
from waiting import PATIENCE_S, wait_for


def of_rclpy(kind, name):
    """Return the stand-in's part of an end: a publisher, subscription, client or server."""
    with NODES_CHANGED:
        ends = [end for node in NODES for end in node.ends]
        (found,) = [end for end in ends if (end.kind, end.name) == (kind, name)]
        return found


@pytest.fixture
def reported(seen):
    return seen()


@pytest.fixture
def transport(fake_rclpy, reported):
    with RclpyTransport(7, notify=reported) as transport:
        yield transport


def test_it_is_opened_by_name(fake_rclpy, types):
    with open_transport("rclpy", 7) as transport:
        assert transport.up
        assert transport.domain == 7
    assert not transport.up


def test_a_middleware_that_makes_no_node_is_reported(fake_rclpy, monkeypatch):
    rclpy = import_rclpy()

    def fail(*_, **options):
        raise rclpy.failure("error creating node")

    monkeypatch.setattr(rclpy.new_node, "__init__", fail)
    with RclpyTransport(7) as transport:
        for use in (partial(transport.node, "n"), transport.graph):
            with pytest.raises(TransportUnavailableError, match="error creating node"):
                use()


def test_a_middleware_that_cannot_be_opened_is_reported(fake_rclpy, monkeypatch):
    contexts = []

    def fail(*, context, **options):
        contexts.append(context)
        raise RCLError("no network")

    monkeypatch.setattr(sys.modules["rclpy"], "init", fail)
    with pytest.raises(TransportUnavailableError, match="no network"):
        RclpyTransport(7)
    assert not contexts[0].ok()


def test_a_process_shows_its_own_nodes_and_endpoints_and_no_others(transport, types):
    assert transport.graph().nodes == ()  # read by a hidden node
    node = transport.node("me")
    node.publisher("a", types.message("std_msgs/msg/Int64"))
    graph = transport.graph()
    assert graph.nodes == ("/me",)
    assert [end.name for end in graph.endpoints] == ["/a"]
    with NODES_CHANGED:
        assert [each.name for each in NODES] == ["me"]


@pytest.mark.parametrize("use", [import_rclpy, partial(find_class, "std_msgs/msg/String")])
def test_what_rclpy_needs_of_the_system_is_told_from_rclpy_itself(use, monkeypatch):
    def import_module(name):
        raise ModuleNotFoundError(name="yaml")

    monkeypatch.setattr("importlib.import_module", import_module)
    with pytest.raises(TransportUnavailableError, match=r"needs yaml, .*--system-site-packages"):
        use()


def test_a_client_that_is_being_closed_has_no_server(transport, types):
    spawn = types.service("turtlesim/srv/Spawn")
    node = transport.node("me")
    node.server("spawn", spawn, print)
    client = node.client("spawn", spawn)
    assert client.ready
    destroyed = of_rclpy("client", "/spawn")
    destroyed.node.destroy_client(destroyed)
    assert not client.ready
    destroyed.service_is_ready = lambda: True  # as it was a moment before
    call = client.call(spawn.request.message(), timeout=PATIENCE_S)
    client.close()
    with pytest.raises(TransportClosedError):
        call.result(PATIENCE_S)


def test_a_shutdown_by_another_part_of_the_process_is_reported(fake_rclpy, reported):
    def notify(notice):
        reported((notice.kind, transport.up))  # which takes the lock that rclpy holds meanwhile

    with RclpyTransport(7, notify=notify) as transport:
        transport.node("me")
        with NODES_CHANGED:
            (node,) = NODES
        node.context.try_shutdown()
        reported.wait(len)
        assert reported == [(NoticeKind.DOWN, False)]


def test_closing_it_is_no_news(transport, reported):
    assert transport.up
    transport.close()
    assert not transport.up  # its executor's thread has shut it down
    assert reported == []


def test_what_comes_when_its_executor_is_gone_is_not_done(fake_rclpy, reported):
    world = RclpyContext(7, "", Notifier(print))
    world.run(reported, "in time")
    reported.wait(len)
    world.close()
    world.run(reported, "late")
    assert reported == ["in time"]


def test_it_may_be_closed_in_a_callback(transport, types, seen):
    number, done = types.message("std_msgs/msg/Int64"), seen()

    def callback(arrival):
        transport.close()
        done(arrival)

    node = transport.node("me")
    node.subscription("a", number, callback)
    node.publisher("a", number).publish(number.message())
    done.wait(len)
    wait_for(lambda: not transport.up)  # its executor's thread shuts it down


def test_its_own_node_is_hidden(transport):
    assert transport.graph().nodes == ()


def test_a_depth_that_the_middleware_does_not_tell_is_the_default(transport, types):
    transport.node("me").publisher("a", types.message("std_msgs/msg/Int64"), Qos(depth=3))
    qos = of_rclpy("publisher", "/a").qos
    qos.history, qos.depth = 3, 0  # unknown
    (end,) = transport.graph().ends("/a", Role.PUBLISHER)
    assert end.qos == Qos()


def test_a_late_answer_to_a_call_that_timed_out_is_dropped(transport, types, seen):
    spawn, kept = types.service("turtlesim/srv/Spawn"), seen()
    node = transport.node("me")
    node.server("spawn", spawn, kept)
    client = node.client("spawn", spawn)
    call = client.call(spawn.request.message(), timeout=0.05)
    with pytest.raises(CallTimeoutError):
        call.result(PATIENCE_S)
    assert of_rclpy("client", "/spawn").pending == {}
    kept[0].answer(spawn.response.message())
    after = client.call(spawn.request.message(), timeout=PATIENCE_S)
    kept.wait(lambda kept: len(kept) == 2)
    kept[1].answer(spawn.response.message(name="next"))
    assert after.result(PATIENCE_S).name == "next"


def test_a_response_that_waits_for_the_executor_is_sent_before_its_server_goes(
    transport, types, seen
):
    spawn, kept = types.service("turtlesim/srv/Spawn"), seen()
    node = transport.node("me")
    server = node.server("spawn", spawn, kept)
    call = node.client("spawn", spawn).call(spawn.request.message(), timeout=PATIENCE_S)
    kept.wait(len)
    with NODES_CHANGED:  # the executor can do nothing meanwhile
        kept[0].answer(spawn.response.message(name="bob"))
        server.close()
    assert call.result(PATIENCE_S).name == "bob"


@pytest.mark.parametrize(
    ("kind", "name"), [("subscription", "/a"), ("client", "/spawn"), ("server", "/spawn")]
)
def test_what_rclpy_cannot_take_is_reported_once_and_what_follows_is_taken(
    transport, types, reported, seen, kind, name
):
    spawn, number = types.service("turtlesim/srv/Spawn"), types.message("std_msgs/msg/Int64")
    got = seen()
    node = transport.node("me")
    node.server("spawn", spawn, lambda request: request.answer(spawn.response.message()))
    client = node.client("spawn", spawn)
    node.subscription("a", number, got)
    publisher = node.publisher("a", number)
    cut_short = of_rclpy(kind, name)
    take, unread = cut_short.take, [1, 2]

    def fail():
        taken = take()
        if unread:
            unread.pop()
            raise RuntimeError("failed to take")
        return taken

    cut_short.take = fail

    def use():
        publisher.publish(number.message())
        return client.call(spawn.request.message(), timeout=PATIENCE_S)

    lost = [use(), use()]
    assert use().result(PATIENCE_S) == spawn.response.message()
    got.wait(len)
    assert not unread
    reported.wait(len)
    assert [(notice.kind, notice.name) for notice in reported] == [(NoticeKind.BAD_MESSAGE, "")]
    assert "failed to take" in reported[0].text
    assert sum(not call.done() for call in lost) == (0 if kind == "subscription" else 2)


@pytest.mark.parametrize("role", ["publisher", "subscription"])
def test_what_the_middleware_reports_deadlines_and_liveliness_is_counted(
    transport, types, reported, role
):
    number, qos = types.message("std_msgs/msg/Int64"), Qos(deadline_ns=500_000_000, lease_ns=10**9)
    node = transport.node("me")
    if role == "publisher":
        end = node.publisher("a", number, qos)
        silence = SimpleNamespace(total_count_change=3)
    else:
        end = node.subscription("a", number, print, qos)
        silence = SimpleNamespace(not_alive_count_change=3)
    events = of_rclpy(role, "/a").events
    events.deadline(SimpleNamespace(total_count_change=2))
    events.deadline(SimpleNamespace(total_count_change=1))
    assert end.broken == 3
    events.liveliness(silence)
    events.liveliness(SimpleNamespace(not_alive_count_change=-1))  # it is back
    assert end.broken == 6
    assert [(notice.kind, notice.name) for notice in reported] == [
        (NoticeKind.QOS_BROKEN, "/a")
    ] * 2
    assert "a deadline of 0.5 s was missed" in reported[0].text
    assert "no sign of life of a publisher within 1 s" in reported[1].text


def test_a_middleware_that_does_not_report_them_is_used_all_the_same(
    transport, types, reported, monkeypatch
):
    monkeypatch.setattr(EventCallbacks, "supported", False)
    number, qos = types.message("std_msgs/msg/Int64"), Qos(deadline_ns=500_000_000)
    node = transport.node("me")
    ends = [node.publisher("a", number, qos), node.subscription("a", number, print, qos)]
    assert [end.broken for end in ends] == [0, 0]
    with NODES_CHANGED:
        assert [end.events.deadline for node in NODES for end in node.ends] == [None] * 2
    assert reported == []


@pytest.mark.parametrize("name", ["no_such_package/msg/Thing", "std_msgs/msg/NoSuchThing"])
def test_a_type_that_the_environment_does_not_have_is_reported(fake_rclpy, name):
    with pytest.raises(TransportUnavailableError, match=name):
        find_class(name)


def test_the_types_of_an_action_are_found_where_rosidl_puts_them(monkeypatch):
    implementation = SimpleNamespace(SendGoalService=1, GetResultService=2, FeedbackMessage=3)
    module = ModuleType("turtlesim.action")
    module.RotateAbsolute = SimpleNamespace(Impl=implementation)
    monkeypatch.setitem(sys.modules, "turtlesim.action", module)
    name = "turtlesim/action/RotateAbsolute"
    found = [find_class(name + end) for end in ("_SendGoal", "_GetResult", "_FeedbackMessage")]
    assert found == [1, 2, 3]
