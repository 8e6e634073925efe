"""What is particular to the transport in memory."""

from __future__ import annotations

import pytest

from llfsm.bridges.ros2.errors import DomainIdError, NoServerError
from llfsm.bridges.ros2.qos import DurabilityPolicy, HistoryPolicy, Qos, ReliabilityPolicy
from llfsm.bridges.ros2.transport import NoticeKind
from memory_transport import MemoryTransport, MemoryWorld
from waiting import PATIENCE_S

LOOSE = Qos(ReliabilityPolicy.BEST_EFFORT)
KEPT = Qos(durability=DurabilityPolicy.TRANSIENT_LOCAL)


@pytest.fixture
def world():
    return MemoryWorld()


@pytest.mark.parametrize(
    ("offered", "asked", "arrives"),
    [
        (Qos(), Qos(), True),
        (Qos(), LOOSE, True),
        (LOOSE, Qos(), False),
        (LOOSE, LOOSE, True),
        (KEPT, Qos(), True),
        (Qos(), KEPT, False),
        (KEPT, KEPT, True),
    ],
)
def test_a_subscription_gets_nothing_from_who_offers_less(
    world, types, seen, offered, asked, arrives
):
    number, got, witnessed = types.message("std_msgs/msg/Int64"), seen(), seen()
    with MemoryTransport(world, notify=seen()) as transport:
        node = transport.node("me")
        publisher = node.publisher("a", number, offered)
        node.subscription("a", number, lambda arrival: got(arrival.decode().data), asked)
        node.subscription("a", number, witnessed, LOOSE)
        publisher.publish(number.message(data=1))
        witnessed.wait(len)
        if arrives:
            got.wait(len)
        assert got == ([1] if arrives else [])


def test_what_is_kept_is_not_for_who_does_not_ask_for_it(world, types, seen):
    number, got = types.message("std_msgs/msg/Int64"), seen()
    with MemoryTransport(world) as transport:
        node = transport.node("me")
        publisher = node.publisher("a", number, KEPT)
        publisher.publish(number.message(data=1))
        node.subscription("a", number, lambda arrival: got(arrival.decode().data))
        publisher.publish(number.message(data=2))
        got.wait(len)
        assert got == [2]


def test_keep_all_keeps_all(world, types, seen):
    number, got = types.message("std_msgs/msg/Int64"), seen()
    everything = Qos(history=HistoryPolicy.KEEP_ALL, depth=1)
    with MemoryTransport(world) as transport:
        node = transport.node("me")
        node.subscription("a", number, lambda arrival: got(arrival.decode().data), everything)
        publisher = node.publisher("a", number)
        for value in range(100):
            publisher.publish(number.message(data=value))
        got.wait(lambda got: len(got) == 100)


def test_a_world_that_is_lost_delivers_nothing_and_says_so(world, types, seen):
    number, spawn = types.message("std_msgs/msg/Int64"), types.service("turtlesim/srv/Spawn")
    reported, got = seen(), seen()
    with MemoryTransport(world, notify=reported) as transport:
        node = transport.node("me")
        node.subscription("a", number, lambda arrival: got(arrival.decode().data))
        publisher, client = node.publisher("a", number), node.client("spawn", spawn)
        node.server("spawn", spawn, lambda request: request.answer(spawn.response.message()))
        assert client.ready
        world.lose()
        world.lose()
        assert not transport.up
        assert not client.ready
        publisher.publish(number.message(data=1))
        with pytest.raises(NoServerError):
            client.call(spawn.request.message(), timeout=PATIENCE_S).result(PATIENCE_S)
        world.restore()
        assert transport.up
        publisher.publish(number.message(data=2))
        got.wait(len)
        client.call(spawn.request.message(), timeout=PATIENCE_S).result(PATIENCE_S)
    assert got == [2]
    assert [notice.kind for notice in reported] == [NoticeKind.DOWN, NoticeKind.UP]


def test_a_domain_that_is_none_is_refused(world):
    with pytest.raises(DomainIdError, match="233"):
        MemoryTransport(world, 233)
