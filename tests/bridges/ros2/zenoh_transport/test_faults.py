"""What a transport over Zenoh does when others fail, or send what they should not."""

from __future__ import annotations

import subprocess
import sys
from contextlib import contextmanager

import pytest
import zenoh

from forked import Forked
from llfsm.bridges.ros2.errors import CdrError
from llfsm.bridges.ros2.graph import Role
from llfsm.bridges.ros2.transport import NoticeKind
from llfsm.bridges.ros2.zenoh_transport.endpoints import pack
from llfsm.bridges.ros2.zenoh_transport.graph import data_key
from llfsm.bridges.ros2.zenoh_transport.transport import ZenohTransport
from waiting import PATIENCE_S, wait_for

GARBAGE = [b"", b"\0", b"\0\1\0\0", b"\0\1\0\0\1\2\3", b"\xff" * 200]


@contextmanager
def running_router(tcp_port):
    """Run `llfsm router`; it is killed without warning."""
    command = [sys.executable, "-m", "llfsm.cli", "router", "--until-eof"]
    with Forked(
        [*command, "--listen", f"tcp/127.0.0.1:{tcp_port}"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        try:
            assert process.stdout.readline().startswith("router: listening on tcp/127.0.0.1")
            yield
        finally:
            process.kill()


def kinds(notices):
    return [notice.kind for notice in notices]


def test_a_router_that_is_killed_is_reported_and_found_again_with_all_that_was_there(
    free_port, types, seen, domain
):
    number = types.message("std_msgs/msg/Int64")
    where = [f"tcp/127.0.0.1:{free_port}"]
    reported, got = seen(), seen()
    with ZenohTransport(domain, router=where, notify=reported) as one:
        assert kinds(reported) == [NoticeKind.DOWN]
        assert "llfsm router" in reported[0].text
        assert not one.up
        publisher = one.node("one").publisher("a", number)
        with running_router(free_port):
            reported.wait(lambda reported: kinds(reported) == [NoticeKind.DOWN, NoticeKind.UP])
            assert one.up
        reported.wait(lambda reported: len(reported) == 3)
        assert kinds(reported)[2] is NoticeKind.DOWN
        assert not one.up
        with running_router(free_port), ZenohTransport(domain, router=where) as two:
            reported.wait(lambda reported: len(reported) == 4)
            assert kinds(reported)[3] is NoticeKind.UP
            two.node("two").subscription("a", number, got)
            for transport in (one, two):
                assert transport.wait_graph(
                    lambda graph: graph.nodes == ("/one", "/two"), PATIENCE_S
                )
                assert transport.wait_graph(lambda graph: len(graph.topics()) == 1, PATIENCE_S)
            publisher.publish(number.message(data=7))
            got.wait(len)
            assert [arrival.decode().data for arrival in got] == [7]


def test_a_router_that_is_there_is_no_news(router, domain, seen):
    reported = seen()
    with ZenohTransport(domain, router=[router], notify=reported) as transport:
        assert transport.up
    assert not reported


def test_a_transport_that_looks_for_no_router_is_up(domain, seen):
    reported = seen()
    with ZenohTransport(domain, router=[], notify=reported) as transport:
        assert transport.up
    assert not reported


def test_garbage_on_a_topic_is_reported_once_and_the_next_message_arrives(
    router, domain, stranger, types, seen
):
    number = types.message("std_msgs/msg/Int64")
    reported, got = seen(), seen()
    key = data_key(domain, "/a", number.dds_name, number.type_hash)
    with ZenohTransport(domain, router=[router], notify=reported) as transport:
        transport.node("we").subscription("a", number, lambda arrival: got(arrival.decode().data))
        attachment = pack(1, 1, b"g" * 16)
        put = zenoh_put(stranger, key)
        for data in GARBAGE:
            put(data, attachment)
        stranger.delete(key)
        put(number.encode(number.message(data=5)), attachment)
        got.wait(len)
        assert got == [5]
    assert [(notice.kind, notice.name) for notice in reported] == [(NoticeKind.BAD_MESSAGE, "/a")]


def zenoh_put(session, key):
    """Return a function that puts, when the subscription that is to get it is known there."""
    publisher = session.declare_publisher(key, congestion_control=zenoh.CongestionControl.BLOCK)
    wait_for(lambda: publisher.matching_status.matching, "the subscription is known")
    return lambda data, attachment: publisher.put(data, attachment=attachment)


def test_a_message_with_a_bad_attachment_or_none_arrives_and_that_is_reported_once(
    router, domain, stranger, types, seen
):
    number = types.message("std_msgs/msg/Int64")
    reported, got = seen(), seen()
    key = data_key(domain, "/a", number.dds_name, number.type_hash)
    with ZenohTransport(domain, router=[router], notify=reported) as transport:
        transport.node("we").subscription("a", number, lambda a: got((a.info, a.decode().data)))
        put = zenoh_put(stranger, key)
        data = number.encode(number.message(data=5))
        for attachment in (None, b"", b"short", b"\0" * 33, b"\0" * 99):
            put(data, attachment)
        put(data, pack(9, 8, b"g" * 16))
        got.wait(lambda got: len(got) == 6)
        assert got == [((0, 0, b""), 5)] * 5 + [((8, 9, b"g" * 16), 5)]
    assert kinds(reported) == [NoticeKind.BAD_MESSAGE]
    assert "attachment" in reported[0].text


def ask(session, key, **what):
    return list(session.get(key, target=zenoh.QueryTarget.ALL_COMPLETE, timeout=PATIENCE_S, **what))


def test_a_bad_request_is_refused_and_reported_once_and_the_next_is_served(
    router, domain, stranger, types, seen
):
    spawn = types.service("turtlesim/srv/Spawn")
    reported = seen()
    key = data_key(domain, "/spawn", spawn.dds_name, spawn.type_hash)
    good = {
        "payload": spawn.request.encode(spawn.request.message(name="x")),
        "attachment": pack(4, 1, b"c" * 16),
    }

    def handler(request):
        request.answer(spawn.response.message(name=request.message.name))

    with ZenohTransport(domain, router=[router], notify=reported) as transport:
        transport.node("we").server("spawn", spawn, handler)
        wait_for(lambda: ask(stranger, key, **good), "the server is known there")
        for bad in [
            {},
            {"payload": good["payload"]},
            {"payload": good["payload"], "attachment": b"short"},
            *({**good, "payload": data} for data in GARBAGE),
        ]:
            (reply,) = ask(stranger, key, **bad)
            assert reply.err is not None
        (reply,) = ask(stranger, key, **good)
        assert spawn.response.decode(reply.ok.payload.to_bytes()).name == "x"
        attachment = reply.ok.attachment.to_bytes()
        assert (attachment[:8], attachment[17:]) == (good["attachment"][:8], b"c" * 16)
    assert [(notice.kind, notice.name) for notice in reported] == [
        (NoticeKind.BAD_MESSAGE, "/spawn")
    ]


def test_a_response_that_cannot_be_decoded_fails_the_call(transport, domain, stranger, types):
    spawn = types.service("turtlesim/srv/Spawn")
    key = data_key(domain, "/spawn", spawn.dds_name, spawn.type_hash)

    def answer(query):
        with query:
            query.reply(key, b"\0\1\0\0garbage")

    with stranger.declare_queryable(key, answer, complete=True):
        client = transport.node("we").client("spawn", spawn)
        assert transport.wait_graph(lambda _: client.ready, PATIENCE_S)
        error = client.call(spawn.request.message(), timeout=PATIENCE_S).exception(PATIENCE_S)
    assert isinstance(error, CdrError)
    assert "Spawn_Response" in str(error)


@pytest.mark.parametrize(
    "token", ["@ros2_lv/{}/x", "@ros2_lv/{}/a/0/1/MP/%/%/n/%a/T/H/nonsense", "@ros2_lv/{}/é/@/**"]
)
def test_a_token_that_says_nothing_is_passed_over(transport, domain, stranger, token):
    if "*" in token:
        token = token.replace("**", "star")
    with stranger.liveliness().declare_token(token.format(domain)):
        node = stranger.liveliness().declare_token(f"@ros2_lv/{domain}/b/0/0/NN/%/%/after")
        assert transport.wait_graph(lambda graph: graph.nodes == ("/after",), PATIENCE_S)
        node.undeclare()
    assert not transport.graph().endpoints


def test_another_version_of_a_type_is_reported(router, domain, stranger, types, seen):
    pose = types.message("turtlesim/msg/Pose")
    reported = seen()
    with ZenohTransport(domain, router=[router], notify=reported) as transport:
        transport.node("we").subscription("pose", pose, print)
        other = f"@ros2_lv/{domain}/b/0/1/MP/%/%/old/%pose/{pose.dds_name}/RIHS01_00/::,10:,:,:,,"
        with stranger.liveliness().declare_token(other):
            assert transport.wait_graph(
                lambda graph: len(graph.ends("/pose", Role.PUBLISHER)) == 1, PATIENCE_S
            )
            reported.wait(len)
    assert [(notice.kind, notice.name) for notice in reported] == [
        (NoticeKind.TYPE_MISMATCH, "/pose")
    ]
    assert "RIHS01_00" in reported[0].text


FORGETFUL = """
import sys
from llfsm.bridges.ros2.types import TypeLibrary
from llfsm.bridges.ros2.zenoh_transport.transport import ZenohTransport

types = TypeLibrary()
node = ZenohTransport(int(sys.argv[1]), router=[sys.argv[2]]).node("forgetful")
number, spawn = types.message("std_msgs/msg/Int64"), types.service("turtlesim/srv/Spawn")
node.subscription("a", number, lambda arrival: arrival.decode())
node.server("spawn", spawn, lambda request: None)
node.client("spawn", spawn).call(spawn.request.message(), timeout=20)
publisher = node.publisher("a", number)
for value in range(100):
    publisher.publish(number.message(data=value))
sys.exit(3)
"""


def test_a_process_that_closes_nothing_ends_as_it_wants_to(router, domain):
    command = [sys.executable, "-c", FORGETFUL, str(domain), router]
    done = subprocess.run(command, timeout=PATIENCE_S, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (3, "")
