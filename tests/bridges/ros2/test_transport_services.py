"""What holds of services on every transport."""

from __future__ import annotations

import gc
import threading
import time

import pytest

from llfsm.bridges.ros2.errors import (
    AlreadyAnsweredError,
    CallFailedError,
    CallTimeoutError,
    NoServerError,
    TransportClosedError,
)
from llfsm.bridges.ros2.graph import Role
from llfsm.bridges.ros2.transport import NoticeKind
from waiting import PATIENCE_S, wait_for


@pytest.fixture
def spawn(types):
    return types.service("turtlesim/srv/Spawn")


@pytest.fixture
def pair(world, spawn):
    """Open two transports, serve on one, return a client on the other that has met the server."""

    def make(handler, reported=None):
        server = world.open(reported).node("serving").server("spawn", spawn, handler)
        transport = world.open()
        client = transport.node("calling").client("spawn", spawn)
        assert transport.wait_graph(lambda _: client.ready, PATIENCE_S)
        return client, server

    return make


@pytest.fixture
def failure(world):
    """Return what a caller gets, and its patience, when the server has no answer."""
    return (CallFailedError, 20) if world.reports_failure else (CallTimeoutError, 0.2)


def test_a_request_is_answered(pair, spawn):
    got = []

    def handler(request):
        got.append(request)
        request.answer(spawn.response.message(name=request.message.name + "!"))

    client, _ = pair(handler)
    before = time.time_ns()
    ask = spawn.request.message
    names = ["bob", "eve", "zoë"]
    answers = [
        client.call(ask(x=1.0, name=name), timeout=PATIENCE_S).result(PATIENCE_S).name
        for name in names
    ]
    assert answers == ["bob!", "eve!", "zoë!"]
    assert [request.message.x for request in got] == [1.0] * 3
    assert [r.info.sequence - got[0].info.sequence for r in got] == [0, 1, 2]
    assert all(before <= request.info.source_ns <= time.time_ns() for request in got)


def test_each_of_many_calls_gets_its_own_answer_in_any_order(pair, spawn):
    waiting, all_there = [], threading.Event()

    def handler(request):
        waiting.append(request)
        if len(waiting) == 20:
            all_there.set()

    client, _ = pair(handler)
    calls = [
        client.call(spawn.request.message(name=f"t{number}"), timeout=PATIENCE_S)
        for number in range(20)
    ]
    assert all_there.wait(PATIENCE_S)
    for request in reversed(waiting):  # on this thread, later
        request.answer(spawn.response.message(name=request.message.name))
    assert [call.result(PATIENCE_S).name for call in calls] == [
        f"t{number}" for number in range(20)
    ]


def test_no_request_is_lost_while_the_server_is_busy(pair, spawn):
    begun, go_on = threading.Event(), threading.Event()

    def handler(request):
        begun.set()
        assert go_on.wait(PATIENCE_S)
        request.answer(spawn.response.message(name=request.message.name))

    client, _ = pair(handler)
    calls = [client.call(spawn.request.message(name="0"), timeout=PATIENCE_S)]
    assert begun.wait(PATIENCE_S)
    calls += [
        client.call(spawn.request.message(name=f"{n}"), timeout=PATIENCE_S) for n in range(1, 40)
    ]
    go_on.set()
    assert [each.result(PATIENCE_S).name for each in calls] == [f"{n}" for n in range(40)]


def test_a_request_that_fails_is_told_from_an_answer(pair, spawn, failure, world):
    client, _ = pair(lambda request: request.fail("no pose yet"))
    error, patience = failure
    with pytest.raises(error, match="no pose yet" if world.reports_failure else None):
        client.call(spawn.request.message(), timeout=patience).result(PATIENCE_S)


def test_a_handler_that_raises_fails_the_request_and_is_reported(pair, spawn, failure, seen):
    reported = seen()

    def handler(request):
        raise ArithmeticError("no good")

    client, _ = pair(handler, reported)
    error, patience = failure
    with pytest.raises(error):
        client.call(spawn.request.message(), timeout=patience).result(PATIENCE_S)
    reported.wait(len)
    assert [(n.kind, n.name) for n in reported] == [(NoticeKind.CALLBACK_FAILED, "/spawn")]


def test_a_request_that_is_dropped_has_failed(pair, spawn, failure):
    client, _ = pair(lambda request: None)
    error, patience = failure
    call = client.call(spawn.request.message(), timeout=patience)
    gc.collect()
    with pytest.raises(error):
        call.result(PATIENCE_S)


def test_a_call_without_a_server_says_so(world, spawn):
    client = world.open().node("calling").client("spawn", spawn)
    assert not client.ready
    with pytest.raises(NoServerError, match="/spawn"):
        client.call(spawn.request.message(), timeout=PATIENCE_S).result(PATIENCE_S)


def test_a_server_with_another_type_is_none(world, types, spawn):
    transport = world.open()
    world.open().node("serving").server("spawn", types.service("std_srvs/srv/Empty"), print)
    client = transport.node("calling").client("spawn", spawn)
    assert transport.wait_graph(lambda graph: bool(graph.ends("/spawn", Role.SERVER)), PATIENCE_S)
    assert not client.ready
    with pytest.raises(NoServerError, match="/spawn"):
        client.call(spawn.request.message(), timeout=PATIENCE_S).result(PATIENCE_S)


def test_a_call_ends_when_its_time_has_passed(pair, spawn):
    kept = []
    client, _ = pair(kept.append)
    with pytest.raises(CallTimeoutError, match="/spawn"):
        client.call(spawn.request.message(), timeout=0.1).result(PATIENCE_S)
    kept[0].answer(spawn.response.message())  # too late, and nobody minds


def test_a_server_that_is_closed_while_it_is_asked_has_failed(pair, spawn, failure, seen):
    kept = seen()
    client, server = pair(kept)
    error, patience = failure
    call = client.call(spawn.request.message(), timeout=patience)
    if kept.wait(len) or error is CallFailedError:
        server.close()
    with pytest.raises(error):
        call.result(PATIENCE_S)


def test_a_client_that_is_closed_ends_its_calls(pair, spawn, seen):
    kept = seen()
    client, _ = pair(kept)
    call = client.call(spawn.request.message(), timeout=PATIENCE_S)
    kept.wait(len)
    client.close()
    with pytest.raises(TransportClosedError, match="/spawn"):
        call.result(PATIENCE_S)
    with pytest.raises(TransportClosedError, match="/spawn"):
        client.call(spawn.request.message(), timeout=PATIENCE_S)


def test_a_request_has_one_answer(pair, spawn):
    kept = []
    client, _ = pair(kept.append)
    call = client.call(spawn.request.message(), timeout=PATIENCE_S)
    wait_for(lambda: kept, "the request")
    assert not call.done()
    kept[0].answer(spawn.response.message(name="first"))
    with pytest.raises(AlreadyAnsweredError, match="/spawn"):
        kept[0].answer(spawn.response.message(name="second"))
    with pytest.raises(AlreadyAnsweredError, match="/spawn"):
        kept[0].fail("third")
    assert call.result(PATIENCE_S).name == "first"


def test_what_follows_a_call_may_call_and_wait_for_the_answer(pair, spawn, seen):
    done = seen()
    client, _ = pair(lambda request: request.answer(spawn.response.message(name="x")))

    def again(call):
        client.call(
            spawn.request.message(name=call.result().name), timeout=PATIENCE_S
        ).add_done_callback(lambda second: done(second.result().name))

    client.call(spawn.request.message(), timeout=PATIENCE_S).add_done_callback(again)
    done.wait(len)
    assert done == ["x"]


def test_a_call_that_is_cancelled_stays_so(pair, spawn, seen):
    kept = seen()
    client, _ = pair(kept)
    call = client.call(spawn.request.message(), timeout=PATIENCE_S)
    kept.wait(len)
    assert call.cancel()
    kept[0].answer(spawn.response.message())
    after = client.call(spawn.request.message(), timeout=PATIENCE_S)
    kept.wait(lambda kept: len(kept) == 2)
    kept[1].answer(spawn.response.message(name="next"))
    assert after.result(PATIENCE_S).name == "next"
    assert call.cancelled()
