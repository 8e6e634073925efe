"""Our nodes and those of another implementation of rmw_zenoh's wire understand each other."""

from __future__ import annotations

import signal
import threading
from concurrent.futures import ThreadPoolExecutor

import pytest

from llfsm.bridges.ros2.errors import CallFailedError, NoServerError
from llfsm.bridges.ros2.graph import Role
from llfsm.bridges.ros2.qos import DurabilityPolicy, Qos, ReliabilityPolicy
from waiting import PATIENCE_S


@pytest.fixture
def twist(types):
    return types.message("geometry_msgs/msg/Twist")


@pytest.fixture
def spawn(types):
    return types.service("turtlesim/srv/Spawn")


def make(of, x, z):
    zero = of.message()
    return of.message(linear=type(zero.linear)(x=x), angular=type(zero.angular)(z=z))


def has(transport, name, role):
    return transport.wait_graph(lambda graph: bool(graph.ends(name, role)), PATIENCE_S)


def test_we_hear_the_peer_and_see_it_on_the_graph(transport, start_peer, twist, seen, types):
    got = seen()
    transport.node("we").subscription("/from_peer", twist, got)
    peer = start_peer()
    peer.do("publisher", "/from_peer")
    assert has(transport, "/from_peer", Role.PUBLISHER)
    for x in range(3):
        peer.do("publish", float(x), -0.5)
    got.wait(lambda got: len(got) == 3)
    assert [arrival.decode() for arrival in got] == [make(twist, x, -0.5) for x in range(3)]
    infos = [arrival.info for arrival in got]
    assert [info.sequence - infos[0].sequence for info in infos] == [0, 1, 2]
    assert len(infos[0].gid) == 16
    (end,) = transport.graph().ends("/from_peer", Role.PUBLISHER)
    assert end[1:5] == ("/peer", "/from_peer", "geometry_msgs/msg/Twist", twist.type_hash)
    assert end.qos == Qos(depth=10)


def test_the_peer_receives_us_and_reads_our_tokens(transport, start_peer, twist):
    node = transport.node("we", "/ns")
    publisher = node.publisher("/to_peer", twist, Qos(ReliabilityPolicy.BEST_EFFORT, depth=3))
    node.subscription("/to_peer", twist, lambda _: None)
    peer = start_peer()
    peer.do("subscriber", "/to_peer", None)
    assert transport.wait_graph(
        lambda graph: len(graph.ends("/to_peer", Role.SUBSCRIPTION)) == 2, PATIENCE_S
    )
    received = threading.Event()

    def publish():
        while not received.wait(0.05):  # its token may be here before its subscription
            publisher.publish(make(twist, 2.0, 1.5))

    with ThreadPoolExecutor() as pool:
        pool.submit(publish)
        try:
            assert peer.event() == ["message", 2.0, 1.5]
        finally:
            received.set()
    (ends,) = (event[1] for event in peer.do("topic", "/to_peer", 3) if event[0] == "info")
    assert ends["publishers"] == [["/ns", "we", twist.type_hash, "2::,3:,:,:,,"]]
    assert ["/ns", "we", twist.type_hash, "::,10:,:,:,,"] in ends["subscribers"]


def test_a_late_peer_gets_what_we_keep(transport, start_peer, twist):
    kept = Qos(durability=DurabilityPolicy.TRANSIENT_LOCAL, depth=1)
    publisher = transport.node("we").publisher("/kept", twist, kept)
    for x in range(4):
        publisher.publish(make(twist, float(x), 0.0))
    peer = start_peer()
    events = []
    for _ in range(20):  # it asks once for what is kept, and may not know us yet
        events = events or peer.do("subscriber", "/kept", ":1:,1:,:,:,,")
    assert events == [["message", 3.0, 0.0]]


def test_we_call_the_peer(transport, start_peer, spawn):
    client = transport.node("we").client("/spawn", spawn)
    peer = start_peer()
    peer.do("server", "/spawn")
    assert transport.wait_graph(lambda _: client.ready, PATIENCE_S)
    names = [
        client.call(spawn.request.message(x=1.5, name=name), timeout=PATIENCE_S)
        .result(PATIENCE_S)
        .name
        for name in ("bob", "eve")
    ]
    assert names == ["bob at 1.5", "eve at 1.5"]


def test_the_peer_calls_us_and_reads_our_token(transport, start_peer, spawn):
    got = []

    def handler(request):
        got.append(request.info)
        if request.message.name == "nobody":
            request.fail("no such turtle")
        else:
            request.answer(spawn.response.message(name=request.message.name.upper()))

    transport.node("we").server("/spawn", spawn, handler)
    peer = start_peer()
    peer.do("client", "/spawn")
    assert has(transport, "/spawn", Role.CLIENT)
    assert peer.do("call", 0.0, "bob") == [["answer", "BOB"]]
    assert peer.do("call", 0.0, "nobody") == [["answer", None]]
    assert peer.do("call", 0.0, "eve") == [["answer", "EVE"]]
    assert [info.sequence - got[0].sequence for info in got] == [0, 1, 2]
    ((_, ends),) = peer.do("service", "/spawn", 2)
    assert ends["servers"] == [["/", "we", spawn.type_hash, "::,10:,:,:,,"]]


def test_a_peer_that_is_killed_is_gone_and_its_service_is_nobodys(
    transport, start_peer, spawn, seen
):
    client = transport.node("we").client("/spawn", spawn)
    peer = start_peer()
    peer.do("server", "/spawn")
    assert transport.wait_graph(lambda _: client.ready, PATIENCE_S)
    peer.process.kill()
    assert transport.wait_graph(lambda graph: not graph.ends("/spawn", Role.SERVER), PATIENCE_S)
    assert transport.wait_graph(
        lambda _: not client.ready, PATIENCE_S
    )  # its token may be gone before it is
    with pytest.raises(NoServerError, match="/spawn"):
        client.call(spawn.request.message(), timeout=PATIENCE_S).result(PATIENCE_S)


def test_a_call_of_a_peer_that_is_killed_meanwhile_ends(transport, start_peer, spawn):
    client = transport.node("we").client("/spawn", spawn)
    peer = start_peer()
    peer.do("server", "/spawn")
    assert transport.wait_graph(lambda _: client.ready, PATIENCE_S)
    peer.process.send_signal(signal.SIGSTOP)  # it will not answer
    call = client.call(spawn.request.message(), timeout=PATIENCE_S)
    peer.process.kill()
    with pytest.raises(CallFailedError, match="/spawn"):
        call.result(PATIENCE_S)
