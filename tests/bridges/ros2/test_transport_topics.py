"""What holds of topics on every transport."""

from __future__ import annotations

import threading
import time
from itertools import pairwise

import pytest

from llfsm.bridges.ros2.errors import RosNameError, TransportClosedError
from llfsm.bridges.ros2.graph import Role
from llfsm.bridges.ros2.qos import DurabilityPolicy, Qos, ReliabilityPolicy
from llfsm.bridges.ros2.transport import NoticeKind
from waiting import PATIENCE_S


@pytest.fixture
def number(types):
    return types.message("std_msgs/msg/Int64")


def met(world, transport, name, subscriptions=1):
    """Wait until a transport knows of a topic's ends, and they of each other."""
    known(transport, name, 1, subscriptions)
    world.meet(name, subscriptions)


def known(transport, name, publishers, subscriptions):
    """Wait until a transport knows of this many ends of a topic."""
    assert transport.wait_graph(
        lambda graph: (
            len(graph.ends(name, Role.PUBLISHER)) >= publishers
            and len(graph.ends(name, Role.SUBSCRIPTION)) >= subscriptions
        ),
        PATIENCE_S,
    ), transport.graph()


def data(arrival):
    return arrival.decode().data


def test_a_message_arrives_as_it_was_published_with_who_when_and_its_number(world, types, seen):
    pose = types.message("turtlesim/msg/Pose")
    one, two = world.open(), world.open()
    got = seen()
    publisher = one.node("talker").publisher("pose", pose)
    two.node("listener").subscription("pose", pose, got)
    met(world, one, "/pose")
    before = time.time_ns()
    sent = [pose.message(x=1.5), pose.message(y=-2.0), pose.message()]
    for message in sent:
        publisher.publish(message)
    got.wait(lambda got: len(got) == 3)
    assert [arrival.decode() for arrival in got] == sent
    assert [arrival.data for arrival in got] == [pose.encode(message) for message in sent]
    infos = [arrival.info for arrival in got]
    counts = [info.sequence - infos[0].sequence for info in infos]
    assert counts == ([0, 1, 2] if world.counts else [0, 0, 0])
    assert all(before <= info.source_ns <= time.time_ns() for info in infos)
    assert {info.gid for info in infos} == {publisher.gid}


def test_a_message_is_forwarded_as_it_came_by_whom_forwards_it(world, types, seen):
    pose = types.message("turtlesim/msg/Pose")
    one, two = world.open(), world.open()
    node, got = two.node("relay"), seen()
    onward = node.publisher("out", pose)
    node.subscription("in", pose, onward.forward)
    one.node("listener").subscription("out", pose, got)
    publisher = one.node("talker").publisher("in", pose)
    met(world, one, "/in")
    met(world, two, "/out")
    before = time.time_ns()
    publisher.publish(pose.message(x=1.5))
    got.wait(len)
    assert got[0].data == pose.encode(pose.message(x=1.5))
    assert got[0].info.gid == onward.gid
    assert before <= got[0].info.source_ns <= time.time_ns()


def test_neither_another_topic_nor_another_domain_receives_it(world, number, seen):
    one, two, elsewhere = world.open(), world.open(), world.open(elsewhere=1)
    right, wrong_name, wrong_domain = seen(), seen(), seen()
    node = two.node("listener")
    node.subscription("a", number, right)
    node.subscription("ns/a", number, wrong_name)
    elsewhere.node("listener").subscription("a", number, wrong_domain)
    publisher = one.node("talker").publisher("a", number)
    met(world, one, "/a")
    for value in range(3):
        publisher.publish(number.message(data=value))
    right.wait(lambda got: len(got) == 3)
    assert not wrong_name
    assert not wrong_domain


def test_the_newest_wins_while_a_callback_is_busy(world, number, seen):
    one, two, witness = world.open(), world.open(), world.open()
    first, go_on, got, witnessed = threading.Event(), threading.Event(), seen(), seen()

    def slow(arrival):
        got(data(arrival))
        first.set()
        assert go_on.wait(PATIENCE_S)

    two.node("listener").subscription("a", number, slow, Qos(depth=1))
    witness.node("witness").subscription("a", number, witnessed, Qos(depth=100))
    publisher = one.node("talker").publisher("a", number, Qos(depth=100))
    met(world, one, "/a", subscriptions=2)
    publisher.publish(number.message(data=0))
    assert first.wait(PATIENCE_S)
    for value in range(1, 51):
        publisher.publish(number.message(data=value))
    witnessed.wait(lambda got: len(got) == 51)
    go_on.set()
    got.wait(lambda got: got[-1] == 50)
    assert got[0] == 0
    assert all(a < b for a, b in pairwise(got))
    assert len(got) < 51


def test_messages_of_one_publisher_arrive_in_order_and_all_within_the_depth(world, number, seen):
    one, two = world.open(), world.open()
    got = seen()
    two.node("listener").subscription("a", number, lambda a: got(data(a)), Qos(depth=200))
    publisher = one.node("talker").publisher("a", number, Qos(depth=200))
    met(world, one, "/a")
    for value in range(200):
        publisher.publish(number.message(data=value))
    got.wait(lambda got: len(got) == 200)
    assert got == list(range(200))


def test_a_late_subscription_gets_what_a_transient_local_publisher_keeps(world, number, seen):
    kept = Qos(durability=DurabilityPolicy.TRANSIENT_LOCAL, depth=3)
    one, two = world.open(), world.open()
    publisher = one.node("talker").publisher("a", number, kept)
    for value in range(5):
        publisher.publish(number.message(data=value))
    known(two, "/a", 1, 0)  # else the newest may be on its way still, and Zenoh drops older ones
    late, volatile = seen(), seen()
    node = two.node("listener")
    node.subscription("a", number, lambda arrival: late(data(arrival)), kept)
    node.subscription("a", number, lambda arrival: volatile(data(arrival)))
    late.wait(lambda got: len(got) >= 3)
    met(world, one, "/a", subscriptions=2)
    publisher.publish(number.message(data=5))
    late.wait(lambda got: got[-1] == 5)
    # On a network, what was published before may also have been on its way still.
    volatile.wait(lambda got: got[-1:] == [5])
    assert late[-4:] == [2, 3, 4, 5]


def test_best_effort_is_received_by_who_asks_for_no_more(world, number, seen):
    loose = Qos(reliability=ReliabilityPolicy.BEST_EFFORT)
    one, two = world.open(), world.open()
    got = seen()
    two.node("listener").subscription("a", number, got, loose)
    publisher = one.node("talker").publisher("a", number, loose)
    met(world, one, "/a")
    got.repeat(lambda: publisher.publish(number.message(data=1)))


def test_a_qos_that_is_less_than_asked_for_is_reported_once(world, number, seen):
    reported = seen()
    one, two = world.open(), world.open(reported)
    two.node("listener").subscription("a", number, seen(), Qos(depth=5))
    node = one.node("talker")
    for _ in range(2):
        node.publisher("a", number, Qos(ReliabilityPolicy.BEST_EFFORT))
    known(two, "/a", 2, 1)
    reported.wait(len)
    assert [(notice.kind, notice.name) for notice in reported] == [(NoticeKind.QOS_MISMATCH, "/a")]
    assert reported[0].text == (
        "New publisher discovered on topic '/a', offering incompatible QoS. "
        "No messages will be sent to it. Last incompatible policy: RELIABILITY_QOS_POLICY "
        "(the subscription of /listener asks for reliable, best effort is offered by /talker)"
    )


def test_another_type_under_our_name_is_reported_once(world, types, number, seen):
    reported = seen()
    one, two = world.open(), world.open(reported)
    two.node("listener").subscription("a", number, seen())
    node = one.node("talker")
    for _ in range(2):
        node.publisher("a", types.message("std_msgs/msg/String"))
    known(two, "/a", 2, 1)
    reported.wait(len)
    assert [(notice.kind, notice.name) for notice in reported] == [(NoticeKind.TYPE_MISMATCH, "/a")]
    assert "std_msgs/msg/String" in reported[0].text


def test_nodes_that_come_and_go_with_another_type_are_reported_up_to_a_number(
    world, types, number, seen
):
    reported = seen()
    one, two = world.open(), world.open(reported)
    two.node("listener").subscription("a", number, seen())
    for at in range(105):
        one.node(f"talker{at}").publisher("a", types.message("std_msgs/msg/String"))
    known(two, "/a", 105, 1)
    reported.wait(lambda got: len(got) == 101)
    assert "others" in reported[100].text
    assert "std_msgs/msg/String" in reported[99].text


def test_a_callback_that_raises_is_reported_once_and_called_again(world, number, seen):
    reported, got = seen(), seen()
    one, two = world.open(), world.open(reported)

    def callback(arrival):
        got(data(arrival))
        raise ArithmeticError("no good")

    two.node("listener").subscription("a", number, callback)
    publisher = one.node("talker").publisher("a", number)
    met(world, one, "/a")
    for value in range(3):
        publisher.publish(number.message(data=value))
    got.wait(lambda got: len(got) == 3)
    reported.wait(len)
    assert [(n.kind, n.name) for n in reported] == [(NoticeKind.CALLBACK_FAILED, "/a")]
    assert "no good" in reported[0].text


def test_who_cannot_be_told_breaks_nothing(world, number, seen):
    def deaf(_):
        raise RuntimeError("I do not listen")

    got = seen()
    one, two = world.open(), world.open(deaf)

    def callback(arrival):
        got(data(arrival))
        raise ArithmeticError

    two.node("listener").subscription("a", number, callback)
    publisher = one.node("talker").publisher("a", number)
    met(world, one, "/a")
    publisher.publish(number.message(data=1))
    publisher.publish(number.message(data=2))
    got.wait(lambda got: len(got) == 2)


def test_nothing_arrives_after_a_subscription_is_closed_and_others_go_on(world, number, seen):
    one, two = world.open(), world.open()
    gone, stays = seen(), seen()
    node = two.node("listener")
    closed = node.subscription("a", number, gone)
    node.subscription("a", number, stays)
    publisher = one.node("talker").publisher("a", number)
    met(world, one, "/a", subscriptions=2)
    closed.close()
    closed.close()
    assert closed.closed
    publisher.publish(number.message(data=1))
    stays.wait(len)
    assert not gone


def test_a_subscription_may_be_closed_in_its_own_callback(world, number, seen):
    one, two = world.open(), world.open()
    got = seen()

    def once(arrival):
        subscription.close()
        got(data(arrival))

    subscription = two.node("listener").subscription("a", number, once)
    publisher = one.node("talker").publisher("a", number)
    met(world, one, "/a")
    publisher.publish(number.message(data=1))
    got.wait(len)
    assert one.wait_graph(lambda graph: not graph.ends("/a", Role.SUBSCRIPTION), PATIENCE_S)


@pytest.mark.parametrize("close", ["publisher", "node", "transport"])
def test_a_publisher_says_that_it_or_its_owner_is_closed(world, number, close):
    transport = world.open()
    node = transport.node("talker")
    publisher = node.publisher("a", number)
    {"publisher": publisher, "node": node, "transport": transport}[close].close()
    with pytest.raises(TransportClosedError, match="/a"):
        publisher.publish(number.message())


def test_nothing_can_be_made_in_what_is_closed(world, number):
    transport = world.open()
    node = transport.node("talker")
    node.close()
    with pytest.raises(TransportClosedError, match="talker"):
        node.publisher("a", number)
    transport.close()
    with pytest.raises(TransportClosedError, match="transport"):
        transport.node("again")
    with pytest.raises(TransportClosedError, match="transport"):
        transport.wait_graph(lambda _: False, PATIENCE_S)


def test_names_are_made_full_and_remapped(world, number):
    node = world.open().node("me", "/ns", {"in": "/else/out", "~/b": "c"})
    assert node.name == "/ns/me"
    names = [node.publisher(name, number).name for name in ("a", "/a", "~/a", "in", "~/b")]
    assert names == ["/ns/a", "/a", "/ns/me/a", "/else/out", "/ns/c"]


def test_a_bad_name_is_refused_and_leaves_nothing(world, number, seen):
    transport = world.open()
    node = transport.node("me")
    with pytest.raises(RosNameError, match="bad name!"):
        node.subscription("bad name!", number, seen())
    with pytest.raises(RosNameError, match="no-node"):
        transport.node("no-node")
    assert transport.wait_graph(lambda graph: graph.nodes == ("/me",), PATIENCE_S)
    assert not transport.graph().endpoints
