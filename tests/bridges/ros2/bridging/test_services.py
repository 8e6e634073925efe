"""Services through slots: requests to ROS, requests from ROS, and what is printed when it fails."""

from __future__ import annotations

import pytest

from llfsm.bridges.ros2.bridging.service_slots import service_slots
from llfsm.bridges.ros2.errors import CallFailedError
from llfsm.whiteboard import Slot
from waiting import PATIENCE_S

SPAWN = "turtlesim/srv/Spawn"


@pytest.fixture
def spawn(types):
    return types.service(SPAWN)


@pytest.fixture
def slots(spawn):
    return service_slots("spawn", spawn)


@pytest.fixture
def serve(peer, spawn):
    """Serve in ROS with a handler."""
    return lambda handler: peer.node("server").server("spawn", spawn, handler)


@pytest.fixture
def call(peer, spawn):
    """Call in ROS: returns the future of a response."""
    client = peer.node("caller").client("spawn", spawn)
    return lambda name="", timeout=20: client.call(
        spawn.request.message(name=name), timeout=timeout
    )


def client_of(start, **more):
    return start(client=[{"service": "spawn", "type": SPAWN, **more}])


def server_of(start, **more):
    return start(server=[{"service": "spawn", "type": SPAWN, **more}])


def answer_to(board, slots, number):
    """Wait for the answer with a number."""
    bound = board[slots.answer]
    sample = bound.wait(after=0, timeout=PATIENCE_S)
    while sample is not None and sample.message.number != number:
        sample = bound.wait(after=sample.count, timeout=PATIENCE_S)
    assert sample is not None
    return sample.message


def test_a_request_in_a_slot_is_a_call(board, start, slots, serve, spawn):
    serve(lambda request: request.answer(spawn.response.message(name=request.message.name + "!")))
    bridge = client_of(start)
    board.add_message(slots.request, slots.request.type(number=1, x=1.5, name="bob"))
    answer = answer_to(board, slots, 1)
    assert (answer.name, answer.failure) == ("bob!", "")
    board.add_message(slots.request, slots.request.type(number=2, name="eve"))
    assert answer_to(board, slots, 2).name == "eve!"
    assert [(link.passed, link.failed) for link in bridge.links] == [(2, 0)]


def test_without_a_server_the_answer_says_so(board, start, slots):
    client_of(start)
    board.add_message(slots.request, slots.request.type(number=1))
    assert answer_to(board, slots, 1).failure == "no server for /spawn"


def test_a_refusal_is_reported(board, start, slots, serve):
    serve(lambda request: request.fail("the field is full"))
    client_of(start)
    board.add_message(slots.request, slots.request.type(number=1))
    assert "the field is full" in answer_to(board, slots, 1).failure


def test_an_answer_that_does_not_come_in_time_is_reported(board, start, slots, serve):
    kept = []
    serve(kept.append)
    client_of(start, timeout=0.1)
    board.add_message(slots.request, slots.request.type(number=1))
    assert "in time" in answer_to(board, slots, 1).failure


def test_a_request_that_ros_cannot_have_is_reported(board, start, slots, serve):
    serve(print)
    client_of(start)
    board.add_message(slots.request, slots.request.type(number=1, x=1e300))
    assert "x" in answer_to(board, slots, 1).failure


def test_what_was_asked_before_the_bridge_is_not_carried_out(board, start, slots, serve, spawn):
    asked = []

    def handler(request):
        asked.append(request.message.name)
        request.answer(spawn.response.message())

    serve(handler)
    board.add_message(slots.request, slots.request.type(number=7, name="old"))
    client_of(start)
    assert "before the bridge" in answer_to(board, slots, 7).failure
    board.add_message(slots.request, slots.request.type(number=8, name="new"))
    assert not answer_to(board, slots, 8).failure
    assert asked == ["new"]


def test_what_was_answered_before_the_bridge_stays_answered(board, start, slots):
    board.add_message(slots.request, slots.request.type(number=7))
    board.add_message(slots.answer, slots.answer.type(number=7, name="bob"))
    client_of(start)
    assert board.get_message(slots.answer).name == "bob"
    assert board[slots.answer].count == 1


def test_requests_that_were_replaced_unseen_are_reported(
    board, start, slots, serve, spawn, reported, seen
):
    kept = seen()
    serve(kept)
    bridge = client_of(start)
    board.add_message(slots.request, slots.request.type(number=1))
    kept.wait(len)  # the first is being carried out
    for number in (2, 3, 4):
        board.add_message(slots.request, slots.request.type(number=number))
    kept[0].answer(spawn.response.message())
    kept.wait(lambda got: len(got) == 2)
    kept[1].answer(spawn.response.message(name="last"))
    assert answer_to(board, slots, 4).name == "last"
    assert ["2 of the requests" in notice.text for notice in reported] == [True]
    assert bridge.links[0].passed == 2


def test_a_bridge_that_ends_while_it_calls_says_so(board, start, slots, serve, seen):
    kept = seen()
    serve(kept)
    bridge = client_of(start)
    board.add_message(slots.request, slots.request.type(number=1))
    kept.wait(len)
    bridge.close()
    assert "closed" in board.get_message(slots.answer).failure


def next_request(board, slots, after):
    sample = board[slots.request].wait(after=after, timeout=PATIENCE_S)
    assert sample is not None
    return sample.message


def test_a_call_in_ros_is_answered_from_a_slot(board, start, slots, call):
    bridge = server_of(start)
    for turn, name in enumerate(("bob", "eve")):
        future = call(name)
        request = next_request(board, slots, turn)
        assert (request.number, request.name) == (turn + 1, name)
        board.add_message(slots.answer, slots.answer.type(request.number, name + "!"))
        assert future.result(PATIENCE_S).name == name + "!"
    assert [(link.passed, link.failed) for link in bridge.links] == [(2, 0)]


def test_numbers_go_on_where_they_were(board, start, slots, call):
    board.add_message(slots.request, slots.request.type(number=41))
    server_of(start)
    call()
    assert next_request(board, slots, 1).number == 42


def test_calls_come_one_by_one_and_answers_to_others_are_not_theirs(board, start, slots, call):
    server_of(start)
    first, second = call("first"), call("second")
    request = next_request(board, slots, 0)
    board.add_message(slots.answer, slots.answer.type(request.number + 5, "not to us"))
    with pytest.raises(TimeoutError):
        first.result(0.1)
    board.add_message(slots.answer, slots.answer.type(request.number, "one"))
    assert first.result(PATIENCE_S).name == "one"
    request = next_request(board, slots, 1)
    assert request.name == "second"
    board.add_message(slots.answer, slots.answer.type(request.number, "two"))
    assert second.result(PATIENCE_S).name == "two"


def test_a_failure_in_the_slot_fails_the_call(board, start, slots, call):
    server_of(start)
    future = call()
    number = next_request(board, slots, 0).number
    board.add_message(slots.answer, slots.answer.type(number, failure="no room"))
    with pytest.raises(CallFailedError, match="no room"):
        future.result(PATIENCE_S)


def test_if_nobody_answers_the_call_fails_and_the_next_one_does_not(board, start, slots, call):
    server_of(start, timeout=0.2)
    with pytest.raises(CallFailedError, match=r"no answer in slot spawn/answer within 0\.2 s"):
        call().result(PATIENCE_S)
    future = call("again")
    number = next_request(board, slots, 1).number
    board.add_message(slots.answer, slots.answer.type(number, "yes"))
    assert future.result(PATIENCE_S).name == "yes"


def test_too_many_calls_at_once_are_refused(board, start, slots, call):
    server_of(start)
    futures = [call() for _ in range(30)]
    refused = futures[-1]
    with pytest.raises(CallFailedError, match="waiting already"):
        refused.result(PATIENCE_S)
    assert not futures[0].done()


def test_a_request_that_is_too_large_for_its_slot_fails(board, start, spawn, call, reported):
    small = service_slots("spawn", spawn, 64)
    assert board[small.request].capacity == 64
    server_of(start)
    with pytest.raises(CallFailedError, match="64"):
        call("x" * 100).result(PATIENCE_S)
    assert len(reported) == 1


def test_a_bridge_that_ends_fails_open_calls(board, start, slots, call):
    bridge = server_of(start)
    future = call()
    next_request(board, slots, 0)
    bridge.close()
    with pytest.raises(CallFailedError, match="ended"):
        future.result(PATIENCE_S)


def test_a_bridge_answers_its_own_client_through_ros(board, start, spawn):
    """Both ends may be on one board, under other names."""
    start(
        client=[{"service": "spawn", "type": SPAWN, "slots": "asking"}],
        server=[{"service": "spawn", "type": SPAWN, "slots": "serving"}],
    )
    asking, serving = service_slots("asking", spawn), service_slots("serving", spawn)
    board.add_message(asking.request, asking.request.type(1, name="bob"))
    number = next_request(board, serving, 0).number
    board.add_message(serving.answer, serving.answer.type(number, "bob"))
    assert answer_to(board, asking, 1).name == "bob"


def test_slots_of_a_machine_with_classes_of_its_own_fit(board, start, slots):
    """A machine needs no bridge to name its slots."""
    client_of(start)
    own = Slot("spawn/request", slots.request.type)
    board.add_message(own, slots.request.type(number=1))
    assert answer_to(board, slots, 1).failure
