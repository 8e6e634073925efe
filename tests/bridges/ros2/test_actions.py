"""An action's server: what it answers and tells, of goals that tests begin and end by hand."""

from __future__ import annotations

from contextlib import contextmanager
from types import SimpleNamespace
from uuid import UUID

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from llfsm.bridges.ros2.actions import ActionServer
from llfsm.bridges.ros2.errors import AlreadyAnsweredError, CallFailedError
from llfsm.bridges.ros2.graph import Role
from llfsm.bridges.ros2.node_time import from_ns, to_ns
from llfsm.bridges.ros2.qos import DurabilityPolicy, Qos
from llfsm.bridges.ros2.threads import CallQueue
from llfsm.bridges.ros2.types import TypeLibrary
from llfsm.runtime import ManualClock
from llfsm.runtime.goals import GoalStatus
from memory_transport import MemoryTransport, MemoryWorld
from thoroughness import examples
from waiting import PATIENCE_S, wait_for

TYPE = "turtlesim/action/RotateAbsolute"
TYPES = TypeLibrary()
OF = TYPES.action(TYPE)
NOBODY = bytes(16)


def key(number):
    return UUID(int=number).bytes


class Scene:
    """A server and a client of one action.

    A goal is accepted if its theta is not negative; to cancel one is refused if it is above 100.
    """

    def __init__(self):
        world = MemoryWorld()
        self.ours, self.theirs = MemoryTransport(world), MemoryTransport(world)
        self.queue, self.clock = CallQueue(), ManualClock()
        self.begun = {}
        self.fails = False
        self.server = ActionServer(
            self.ours.node("server"),
            "turn",
            OF,
            TYPES,
            begin=self.begin,
            cancel=lambda goal: goal.message.theta <= 100,
            put=self.queue.put,
            now_ns=self.clock.now_ns,
        )
        node = self.theirs.node("client")
        cancel = TYPES.service("action_msgs/srv/CancelGoal")
        self.services = {
            "send_goal": (node.client("turn/_action/send_goal", OF.send_goal), OF.send_goal),
            "get_result": (node.client("turn/_action/get_result", OF.get_result), OF.get_result),
            "cancel_goal": (node.client("turn/_action/cancel_goal", cancel), cancel),
        }

    def begin(self, goal):
        if self.fails:
            raise ArithmeticError("no good")
        if goal.message.theta < 0:
            return False
        self.begun[goal.info.goal_id.uuid] = goal
        return True

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.ours.close()
        self.theirs.close()

    def wait(self, ready):
        wait_for(ready, between=self.queue.run_pending)

    def ask(self, name, **fields):
        client, of = self.services[name]
        future = client.call(of.request.message(**fields), timeout=PATIENCE_S)
        self.wait(lambda: future.done() or len(self.queue))
        self.queue.run_pending()
        return future

    def call(self, name, **fields):
        future = self.ask(name, **fields)
        self.wait(future.done)
        return future.result()

    def send(self, number, theta=1.0):
        self.clock.advance(ns=1)
        return self.call("send_goal", goal_id=self.id(number), goal=OF.goal.message(theta=theta))

    def cancel(self, number=None, until=None):
        """Return the code and the numbers of the goals that are being cancelled."""
        info = TYPES.message("action_msgs/msg/GoalInfo").message
        answer = self.call(
            "cancel_goal",
            goal_info=info(
                goal_id=self.id(number or 0),
                stamp=from_ns(until or 0),
            ),
        )
        numbers = {UUID(bytes=each.goal_id.uuid).int for each in answer.goals_canceling}
        return answer.return_code, numbers

    def end(self, number, status=GoalStatus.SUCCEEDED, delta=0.0):
        self.begun[key(number)].end(status, OF.result.message(delta=delta))

    def status(self, number):
        return self.begun[key(number)].status

    def statuses(self):
        """Return what a subscription that comes now gets of the status topic."""
        got = []
        kept = Qos(durability=DurabilityPolicy.TRANSIENT_LOCAL, depth=1)
        of = TYPES.message("action_msgs/msg/GoalStatusArray")
        with self.theirs.node("late") as node:
            node.subscription("turn/_action/status", of, got.append, kept)
            self.wait(lambda: got)
        return {
            UUID(bytes=each.goal_info.goal_id.uuid).int: each.status
            for each in got[0].decode().status_list
        }

    @staticmethod
    def id(number):
        return TYPES.message("unique_identifier_msgs/msg/UUID").message(uuid=key(number))


@pytest.fixture
def scene():
    with Scene() as scene:
        yield scene


def test_a_goal_is_accepted_and_executed_at_once(scene):
    answer = scene.send(1, theta=2.5)
    assert answer.accepted
    assert to_ns(answer.stamp) == scene.clock.now_ns()
    assert scene.begun[key(1)].message.theta == 2.5
    assert scene.statuses() == {1: GoalStatus.EXECUTING}


def test_a_refused_goal_is_forgotten(scene):
    assert not scene.send(1, theta=-1.0).accepted
    assert scene.call("get_result", goal_id=scene.id(1)).status == GoalStatus.UNKNOWN
    assert scene.send(1).accepted


@pytest.mark.parametrize("ended", [False, True])
def test_an_id_that_is_known_is_refused(scene, ended):
    scene.send(1)
    goal = scene.begun[key(1)]
    if ended:
        scene.end(1)
    assert not scene.send(1).accepted
    assert scene.begun[key(1)] is goal
    assert set(scene.statuses()) == {1}


@pytest.mark.parametrize(
    "status", [GoalStatus.SUCCEEDED, GoalStatus.CANCELED, GoalStatus.ABORTED], ids=str
)
def test_the_result_reaches_who_waits_and_who_asks_later(scene, status):
    scene.send(1)
    waiting = [scene.ask("get_result", goal_id=scene.id(1)) for _ in range(2)]
    assert not any(each.done() for each in waiting)
    scene.end(1, status, delta=0.5)
    later = scene.call("get_result", goal_id=scene.id(1))
    assert (later.status, later.result.delta) == (status, 0.5)
    assert [each.result(PATIENCE_S) for each in waiting] == [later, later]
    assert scene.statuses() == {1: status}


def test_a_result_is_kept_for_ten_seconds_after_the_end(scene):
    scene.send(1)
    scene.clock.advance(s=60)
    assert scene.status(1) is GoalStatus.EXECUTING
    scene.end(1)
    scene.clock.advance(s=10)
    assert scene.call("get_result", goal_id=scene.id(1)).status == GoalStatus.SUCCEEDED
    scene.clock.advance(ns=1)
    assert scene.call("get_result", goal_id=scene.id(1)).status == GoalStatus.UNKNOWN
    scene.send(2)
    assert set(scene.statuses()) == {2}


def test_a_goal_ends_once(scene):
    scene.send(1)
    scene.end(1, GoalStatus.ABORTED)
    with pytest.raises(AlreadyAnsweredError, match="ABORTED"):
        scene.end(1)
    assert scene.status(1) is GoalStatus.ABORTED


def test_feedback_bears_the_goals_id(scene):
    got = []
    scene.theirs.node("eager").subscription(
        "turn/_action/feedback", OF.feedback_message, got.append
    )
    scene.send(1)
    scene.begun[key(1)].publish_feedback(OF.feedback.message(remaining=0.25))
    scene.wait(lambda: got)
    message = got[0].decode()
    assert (message.goal_id.uuid, message.feedback.remaining) == (key(1), 0.25)


def test_cancelling_asks_whoever_follows_the_goal(scene):
    scene.send(1)
    assert scene.cancel(1) == (0, {1})
    assert scene.status(1) is GoalStatus.CANCELING
    assert scene.statuses() == {1: GoalStatus.CANCELING}
    scene.end(1, GoalStatus.CANCELED)
    assert scene.call("get_result", goal_id=scene.id(1)).status == GoalStatus.CANCELED


def test_cancelling_by_id_says_why_not(scene):
    rejected, unknown, terminated = 1, 2, 3
    scene.send(1, theta=101.0)
    assert scene.cancel(1) == (rejected, set())
    assert scene.status(1) is GoalStatus.EXECUTING
    assert scene.cancel(9) == (unknown, set())
    scene.send(2)
    assert scene.cancel(2) == (0, {2})
    assert scene.cancel(2) == (terminated, set())  # it is being cancelled already
    scene.end(2, GoalStatus.CANCELED)
    assert scene.cancel(2) == (terminated, set())


@settings(max_examples=examples(20), deadline=None)  # each opens two transports
@given(
    st.lists(st.sampled_from(["run", "ended", "stubborn"]), min_size=1, max_size=5),
    st.integers(0, 5),
    st.integers(0, 6),
)
def test_cancelling_by_time_and_id(kinds, until, number):
    """Goals 1, 2, ...: cancel those up to `until` (0: no time given) and `number` (0: no id)."""
    with Scene() as scene:
        stamps = {0: 0}
        for goal, kind in enumerate(kinds, 1):
            stamps[goal] = to_ns(scene.send(goal, 101.0 if kind == "stubborn" else 1.0).stamp)
            if kind == "ended":
                scene.end(goal)
        until = min(until, len(kinds))
        if until:
            meant = {goal for goal in stamps if 0 < goal <= until} | {number}
        else:
            meant = {number} if number else set(stamps)
        active = {goal for goal, kind in enumerate(kinds, 1) if goal in meant and kind != "ended"}
        agreed = {goal for goal in active if kinds[goal - 1] != "stubborn"}
        code, cancelled = scene.cancel(number, stamps[until])
        assert cancelled == agreed
        if active:
            assert code == (0 if agreed else 1)
        elif number and not until:
            assert code == (3 if number <= len(kinds) else 2)
        else:
            assert code == 0
        for goal in active:
            expected = GoalStatus.CANCELING if goal in agreed else GoalStatus.EXECUTING
            assert scene.status(goal) is expected


class Orderly:
    """A node, and its only client, that note what a server sends, in its order."""

    def __init__(self):
        self.sent, self.handlers = [], {}

    @contextmanager
    def publisher(self, name, *_):
        yield SimpleNamespace(publish=lambda _: self.sent.append(name.rpartition("/")[2]))

    @contextmanager
    def server(self, name, _, handler):
        self.handlers[name.rpartition("/")[2]] = handler
        yield

    def ask(self, service, of, **fields):
        self.handlers[service](
            SimpleNamespace(
                message=of.request.message(**fields), answer=lambda _: self.sent.append(service)
            )
        )

    def take(self):
        sent, self.sent = self.sent, []
        return sent


def test_answers_and_statuses_come_in_the_order_of_rclcpp():
    node, goals = Orderly(), []
    ActionServer(
        node,
        "turn",
        OF,
        TYPES,
        begin=lambda goal: goals.append(goal) is None,
        cancel=lambda _: True,
        put=lambda do: do(),
    )
    goal_id = Scene.id(1)
    node.ask("send_goal", OF.send_goal, goal_id=goal_id, goal=OF.goal.message())
    assert node.take() == ["send_goal", "status"]
    node.ask("get_result", OF.get_result, goal_id=goal_id)
    node.ask("cancel_goal", TYPES.service("action_msgs/srv/CancelGoal"))
    assert node.take() == ["status", "cancel_goal"]
    goals[0].end(GoalStatus.CANCELED, OF.result.message())
    assert node.take() == ["get_result", "status"]


def test_a_server_that_is_closed_is_off_the_graph_and_who_waits_gets_no_result(scene):
    scene.send(1)
    waiting = scene.ask("get_result", goal_id=scene.id(1))
    scene.server.close()
    with pytest.raises(CallFailedError):
        waiting.result(PATIENCE_S)
    ends = scene.theirs.graph().endpoints
    assert {end.role for end in ends if "turn" in end.name} == {Role.CLIENT}


def test_a_goal_whose_beginning_fails_has_failed_and_the_next_is_taken(scene, caplog):
    scene.fails = True
    with pytest.raises(CallFailedError):
        scene.send(1)
    assert "no good" in caplog.text
    scene.fails = False
    assert scene.send(1).accepted
