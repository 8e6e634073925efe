"""Actions through slots, on every transport: goals that machines send, and that they serve."""

from __future__ import annotations

import os
import threading
from concurrent.futures import Future
from functools import partial
from pathlib import Path
from uuid import uuid4

import msgspec
import pytest

from llfsm.bridges.ros2.actions import ActionClient
from llfsm.bridges.ros2.bridging import action_slots
from llfsm.bridges.ros2.bridging import bridge as bridge_module
from llfsm.bridges.ros2.bridging.bridge import Bridge
from llfsm.bridges.ros2.bridging.bridge_config import BridgeConfig
from llfsm.bridges.ros2.bridging.bridge_plan import make_plan
from llfsm.bridges.ros2.graph import Role
from llfsm.bridges.ros2.threads import TimerThread
from llfsm.runtime.goals import CancelGoal, GoalStanding, GoalStatus
from llfsm.whiteboard.messages.llfsm import LastWill, SafeValue, will_slot
from waiting import PATIENCE_S, wait_for

from .acting import EXAMPLE, FEEDBACK, GOAL, OF, RESULT, SLOTS, Caller, Client, Navigator

CONFIG = {"action": "navigate_to_pose", "type": OF.name, "slots": "navigate"}


pytestmark = pytest.mark.usefixtures("nav2_msgs")


@pytest.fixture
def navigator(world):
    return Navigator(world.open())


@pytest.fixture
def bridge(world, board):
    """Run a bridge on a transport of this kind, with an action; it ends with the test."""
    running = []

    def start(*others, **more):
        actions = [CONFIG | more, *(CONFIG | other for other in others)]
        config = msgspec.convert(
            {"types": [str(EXAMPLE / "nav2_msgs")], "action": actions}, BridgeConfig
        )
        plan, faults = make_plan(config, Path(), board.slots())
        assert not faults
        running.append(Bridge(plan, board, world.open(), lambda _: None))
        return running[-1]

    yield start
    for each in running:
        each.close()


@pytest.fixture
def client(board, bridge, navigator):
    return Client(board, bridge(timeout=PATIENCE_S), navigator)


def test_a_goal_is_accepted_reported_on_and_ended(client, board, navigator):
    goal = client.drives()
    assert goal.message.behavior_tree == "tree"
    wait_for(
        lambda: board[SLOTS.feedback].get() == FEEDBACK(1, distance_remaining=0.5),
        between=lambda: goal.publish_feedback(OF.feedback.message(distance_remaining=0.5)),
    )
    goal.end(GoalStatus.SUCCEEDED, OF.result.message(error_msg="there"))
    standing = client.stands(GoalStatus.SUCCEEDED)
    assert standing.has_succeeded(1)
    assert not standing.has_failed(1)
    expected = RESULT(1, error_msg="there", status=GoalStatus.SUCCEEDED)
    assert board[SLOTS.result].get() == expected


def test_two_goals_are_in_flight_through_slots_of_their_own(board, bridge, navigator):
    slots = [SLOTS, action_slots("second", OF)]
    links = bridge({"slots": "second"}).links
    navigator.until(lambda: all(link.client.ready for link in links))
    for number, each in enumerate(slots, 1):
        board.add_message(each.goal, each.goal.type(1, behavior_tree=each.goal.name))
        navigator.until(lambda number=number: len(navigator.begun) == number)
    for goal in navigator.begun:
        goal.end(GoalStatus.SUCCEEDED, OF.result.message(error_msg=goal.message.behavior_tree))
    navigator.until(lambda: all(board[each.result].get() is not None for each in slots))
    found = [board[each.result].get().error_msg for each in slots]
    assert found == ["navigate/goal", "second/goal"]


@pytest.mark.parametrize("number", [0, 1])
def test_a_goal_is_cancelled_by_its_number_or_as_the_active_one(client, board, number):
    goal = client.drives()
    board.add_message(SLOTS.cancel, CancelGoal(7))  # that is another one
    board.add_message(SLOTS.cancel, CancelGoal(number))
    client.stands(GoalStatus.CANCELING)
    goal.end(GoalStatus.CANCELED, OF.result.message())
    assert client.stands(GoalStatus.CANCELED).has_failed(1)


def test_a_cancellation_before_the_answer_is_not_lost(board, bridge, navigator, monkeypatch):
    done = []

    class NotingTimer(TimerThread):
        """The thread on which all that happens to goals is handled."""

        def call_soon(self, do):
            super().call_soon(lambda: done.append(do()))

    monkeypatch.setattr(bridge_module, "TimerThread", NotingTimer)
    client = Client(board, bridge(timeout=PATIENCE_S), navigator)
    client.send()
    wait_for(lambda: len(navigator.queue))  # the goal is there, and not answered
    before = len(done)
    board.add_message(SLOTS.cancel, CancelGoal())
    wait_for(lambda: len(done) > before)
    client.stands(GoalStatus.CANCELING)


def test_a_cancellation_before_a_goal_does_not_cancel_that_one(
    board, bridge, navigator, monkeypatch
):
    """Also if the bridge finds the goal first: a machine ends, and the next one sends a goal."""
    held, canceled, cancel_goal = None, [], ActionClient.cancel_goal

    def note(self, key, timeout):
        canceled.append(key)
        return cancel_goal(self, key, timeout)

    class HoldingTimer(TimerThread):
        def call_soon(self, do):
            if held is None:
                super().call_soon(do)
            else:
                held.append(partial(super().call_soon, do))

    monkeypatch.setattr(bridge_module, "TimerThread", HoldingTimer)
    monkeypatch.setattr(ActionClient, "cancel_goal", note)
    client = Client(board, bridge(timeout=PATIENCE_S), navigator)
    client.drives()
    held = []
    board.add_message(SLOTS.cancel, CancelGoal())
    wait_for(lambda: held)
    client.send()
    wait_for(lambda: len(held) > 1)
    found, held = held, None
    for handle in reversed(found):
        handle()
    navigator.until(lambda: len(navigator.begun) == 2)
    navigator.begun[-1].end(GoalStatus.SUCCEEDED, OF.result.message())
    client.stands(GoalStatus.SUCCEEDED)
    assert canceled == []


def test_a_server_that_does_not_cancel_is_reported(client, board, navigator):
    navigator.cancels = False
    client.drives()
    board.add_message(SLOTS.cancel, CancelGoal())
    navigator.until(lambda: client.standings.get().failure)
    standing = client.standings.get()
    assert (standing.number, standing.status.active) == (1, True)
    assert standing.failure == "the server refused to cancel it (code 1)"


def test_a_refused_goal_has_failed(client, board, navigator):
    navigator.accepts = False
    client.send()
    standing = client.stands(GoalStatus.REFUSED)
    assert standing.has_failed(1)
    assert standing.failure == board[SLOTS.result].get().failure == "the server refused the goal"


def test_only_the_newest_goal_is_reported(client, board, navigator):
    first = client.drives()
    second = client.drives()
    first.end(GoalStatus.ABORTED, OF.result.message(error_code=1))
    second.end(GoalStatus.SUCCEEDED, OF.result.message(error_code=2))
    client.stands(GoalStatus.SUCCEEDED)
    assert board[SLOTS.result].get().error_code == 2
    assert board[SLOTS.result].count == 1


def test_without_a_server_a_goal_is_refused(bridge, board):
    bridge()
    board.add_message(SLOTS.goal, GOAL(1))
    standings = board[SLOTS.status]
    wait_for(lambda: standings.get() is not None)
    assert standings.get().status is GoalStatus.REFUSED
    assert "no server" in standings.get().failure


@pytest.fixture
def goals_may_take_longer(monkeypatch):
    """Limit by the bridge's timeout all but the answer to a goal, which a test waits for."""
    send = ActionClient.send_goal
    monkeypatch.setattr(
        ActionClient, "send_goal", lambda self, key, goal, _: send(self, key, goal, PATIENCE_S)
    )


@pytest.mark.usefixtures("goals_may_take_longer")
def test_a_goal_whose_server_goes_is_aborted(board, bridge, navigator):
    client = Client(board, bridge(timeout=0.2), navigator)
    client.drives()
    navigator.server.close()
    assert client.stands(GoalStatus.ABORTED).failure


def test_a_goal_from_before_the_bridge_is_not_sent(bridge, board, navigator):
    board.add_message(SLOTS.goal, GOAL(3))
    client = Client(board, bridge(), navigator)
    assert "before the bridge" in client.stands(GoalStatus.REFUSED, 3).failure
    assert not navigator.begun


def test_a_goal_of_a_bridge_that_was_lost_is_aborted(bridge, board, navigator):
    board.add_message(SLOTS.goal, GOAL(3))
    board.add_message(SLOTS.status, GoalStanding(3, GoalStatus.EXECUTING))
    client = Client(board, bridge(), navigator)
    assert "was lost" in client.stands(GoalStatus.ABORTED, 3).failure
    assert board[SLOTS.result].get().status is GoalStatus.ABORTED
    assert not navigator.begun


@pytest.mark.parametrize(
    ("slot", "state", "cancels"),
    [
        (SLOTS.cancel.name, "executed", True),
        (SLOTS.cancel.name, "withdrawn", False),
        ("cmd_vel", "executed", False),
    ],
)
def test_a_goal_is_cancelled_by_the_last_will_of_its_machine(client, board, slot, state, cancels):
    """A guard has executed it, and posted nothing: the machine had not canceled yet."""
    value = SafeValue(slot, SLOTS.cancel.encoder.encode(CancelGoal()))
    will = LastWill(os.getpid(), 0, "", 0, (value,))
    board.add_message(will_slot("Patrol"), will)
    goal = client.drives()
    board.add_message(will_slot("Patrol"), msgspec.structs.replace(will, state=state))
    if cancels:
        client.stands(GoalStatus.CANCELING)
    goal.end(GoalStatus.CANCELED if cancels else GoalStatus.SUCCEEDED, OF.result.message())
    client.stands(GoalStatus.CANCELED if cancels else GoalStatus.SUCCEEDED)


@pytest.mark.usefixtures("goals_may_take_longer")
def test_a_result_that_does_not_come_is_asked_for_again(board, bridge, navigator, monkeypatch):
    """Its server was killed, and another one is there before anybody has noticed."""
    ask, calls = ActionClient.get_result, []

    def lose_the_first(self, key):
        calls.append(key)
        return ask(self, key) if len(calls) > 1 else Future()

    monkeypatch.setattr(ActionClient, "get_result", lose_the_first)
    client = Client(board, bridge(timeout=0.01), navigator)
    goal = client.drives()
    goal.end(GoalStatus.SUCCEEDED, OF.result.message())
    client.stands(GoalStatus.SUCCEEDED)


def test_the_end_of_the_bridge_cancels_the_active_goal(client, navigator):
    goal = client.drives()
    ending = threading.Thread(target=client.bridge.close)
    ending.start()
    navigator.until(lambda: goal.status is GoalStatus.CANCELING)
    ending.join()
    assert client.standings.get().failure == "the bridge has ended"


@pytest.fixture
def caller(world):
    return Caller(world.open())


def serving(board, bridge, caller, **more):
    """Serve, and send a goal that the machine has seen; return the future of its answer."""
    caller.bridge = bridge(role="server", **more)
    answer = caller.send(behavior_tree="tree")
    wait_for(lambda: board[SLOTS.goal].get() == GOAL(1, behavior_tree="tree"))
    return answer


def accept(board, number=1):
    board.add_message(SLOTS.status, GoalStanding(number, GoalStatus.EXECUTING))


def test_a_machine_accepts_reports_on_and_ends_a_goal(board, bridge, caller):
    answer = serving(board, bridge, caller)
    assert not answer.done()
    accept(board)
    assert answer.result(PATIENCE_S).accepted
    reported = FEEDBACK(1, number_of_recoveries=2)
    wait_for(lambda: caller.feedback, between=lambda: board.add_message(SLOTS.feedback, reported))
    assert caller.feedback[0] == (caller.key, OF.feedback.message(number_of_recoveries=2))
    result = caller.get_result()
    ended = RESULT(0, error_msg="there", status=GoalStatus.SUCCEEDED)
    board.add_message(SLOTS.result, ended)  # 0: whichever there is, as at the machine's end
    response = result.result(PATIENCE_S)
    assert (response.status, response.result.error_msg) == (4, "there")
    wait_for(lambda: (caller.key, GoalStatus.SUCCEEDED) in caller.statuses)


def test_a_machine_refuses_a_goal_and_gets_the_next(board, bridge, caller):
    answer = serving(board, bridge, caller)
    board.add_message(SLOTS.status, GoalStanding(1, GoalStatus.REFUSED, "the battery is low"))
    assert not answer.result(PATIENCE_S).accepted
    caller.key = uuid4().bytes
    caller.send(behavior_tree="next")
    wait_for(lambda: board[SLOTS.goal].get() == GOAL(2, behavior_tree="next"))


def test_a_second_goal_is_refused_while_one_is_there(board, bridge, caller):
    serving(board, bridge, caller)
    caller.key = uuid4().bytes
    assert not caller.send().result(PATIENCE_S).accepted
    assert board[SLOTS.goal].count == 1


def test_a_machine_that_does_not_answer_refuses(board, bridge, caller):
    assert not serving(board, bridge, caller, timeout=0.05).result(PATIENCE_S).accepted
    assert board[SLOTS.cancel].get() == CancelGoal(1)  # or it would begin a goal of nobody


@pytest.mark.parametrize("ends", [False, True])
def test_a_goal_of_a_bridge_that_was_lost_is_cancelled(board, bridge, ends):
    board.add_message(SLOTS.goal, GOAL(3))
    accept(board, 3)
    if ends:
        board.add_message(SLOTS.result, RESULT(3, status=GoalStatus.SUCCEEDED))
    bridge(role="server")
    assert board[SLOTS.cancel].get() == (None if ends else CancelGoal(3))


def test_a_machine_is_asked_to_cancel_and_decides_how_it_ends(board, bridge, caller):
    answer = serving(board, bridge, caller)
    accept(board)
    answer.result(PATIENCE_S)
    response = caller.cancel_goal(PATIENCE_S).result(PATIENCE_S)
    assert [each.goal_id.uuid for each in response.goals_canceling] == [caller.key]
    wait_for(lambda: board[SLOTS.cancel].get() == CancelGoal(1))
    board.add_message(SLOTS.result, RESULT(1, status=GoalStatus.CANCELED))
    assert caller.get_result().result(PATIENCE_S).status == GoalStatus.CANCELED


@pytest.mark.parametrize("status", [GoalStatus.CANCELED, GoalStatus.EXECUTING])
def test_a_goal_cannot_end_as_what_nobody_asked_for(board, bridge, caller, status):
    answer = serving(board, bridge, caller)
    board.add_message(SLOTS.result, RESULT(1, status=status))
    assert answer.result(PATIENCE_S).accepted
    assert caller.get_result().result(PATIENCE_S).status == GoalStatus.ABORTED


def test_the_end_of_the_bridge_aborts_the_goal(board, bridge, caller, world):
    answer = serving(board, bridge, caller)
    accept(board)
    answer.result(PATIENCE_S)
    result = caller.get_result()
    caller.key = uuid4().bytes
    caller.get_result().result(PATIENCE_S)  # of no goal: once answered, the one before has arrived
    caller.bridge.close()
    assert result.result(PATIENCE_S).status == GoalStatus.ABORTED
    assert board[SLOTS.cancel].get() == CancelGoal(1)  # so the machine does not go on alone


def test_the_ends_on_the_graph_are_those_of_rclcpp(board, bridge, world):
    bridge()
    transport = world.open()

    def ends(role):
        return {
            (end.name, end.type_name)
            for end in transport.graph().endpoints
            if end.role is role and end.node == "/llfsm_bridge" and "_action" in end.name
        }

    def of(part):
        return f"/navigate_to_pose/_action/{part}"

    expected = {
        Role.CLIENT: {
            (of("send_goal"), "nav2_msgs/action/NavigateToPose_SendGoal"),
            (of("cancel_goal"), "action_msgs/srv/CancelGoal"),
            (of("get_result"), "nav2_msgs/action/NavigateToPose_GetResult"),
        },
        Role.SUBSCRIPTION: {
            (of("feedback"), "nav2_msgs/action/NavigateToPose_FeedbackMessage"),
            (of("status"), "action_msgs/msg/GoalStatusArray"),
        },
    }
    transport.wait_graph(lambda _: {role: ends(role) for role in expected} == expected, PATIENCE_S)
    assert {role: ends(role) for role in expected} == expected
