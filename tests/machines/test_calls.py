"""Machines that call actions and services through a bridge's slots, answered by the test."""

from __future__ import annotations

from typing import Any, NamedTuple

import pytest

from llfsm.machines import CallAction, CallService
from llfsm.runtime import Arrangement, DefinitionError, ExecutionError, Machine, ManualClock, State
from llfsm.runtime.goals import CancelGoal, GoalStanding, GoalStatus
from llfsm.whiteboard import Message, Slot
from llfsm.whiteboard.local import LocalBoard


class Goal(Message, type_name="test/Goal"):
    number: int = 0
    x: float = 0.0


class Answer(Message, type_name="test/Answer"):
    number: int = 0
    opened: bool = False
    failure: str = ""


class Action(NamedTuple):
    goal: Slot[Goal] = Slot("go/goal", Goal)
    cancel: Slot[CancelGoal] = Slot("go/cancel", CancelGoal)
    status: Slot[GoalStanding] = Slot("go/status", GoalStanding)


class Service(NamedTuple):
    request: Slot[Goal] = Slot("door/request", Goal)
    answer: Slot[Answer] = Slot("door/answer", Answer)


GO, DOOR = Action(), Service()


class Caller:
    """A machine whose state runs a call, in simulated time, a turn every 100 ms."""

    def __init__(self, call: type[Machine]) -> None:
        class Mission(Machine):
            CALL = State(runs=call)
            THERE = State(final=False)
            FAILED = State(final=False)
            CALL.to(THERE, when_done=True)
            CALL.to(FAILED, when_failed=True)

        self.clock = ManualClock()
        self.board = LocalBoard(now_ns=self.clock.now_ns)
        self.mission = Arrangement([Mission], whiteboard=self.board, clock=self.clock)

    def go_on(self, ms: float = 300) -> str:
        for _ in range(round(ms / 100)):
            self.mission.round()
            self.clock.advance(ms=100)
        return self.mission.states()["Mission"]

    def get(self, slot: Slot[Any]) -> Any:
        return self.board.get_message(slot)

    def stand(self, status: GoalStatus, failure: str = "") -> None:
        number = self.get(GO.goal).number
        self.board.add_message(GO.status, GoalStanding(number, status, failure))


def test_a_goal_that_succeeds_is_done() -> None:
    caller = Caller(CallAction(GO, Goal(x=2.0)))
    caller.go_on()
    assert caller.get(GO.goal) == Goal(1, 2.0)
    caller.stand(GoalStatus.EXECUTING)
    assert caller.go_on(5000) == "CALL"
    caller.stand(GoalStatus.SUCCEEDED)
    assert caller.go_on() == "THERE"


@pytest.mark.parametrize("status", [GoalStatus.REFUSED, GoalStatus.CANCELED, GoalStatus.ABORTED])
def test_a_goal_that_does_not_succeed_fails_with_the_reason(status: GoalStatus) -> None:
    caller = Caller(CallAction(GO, Goal()))
    caller.go_on()
    caller.stand(status, "the way is blocked")
    assert caller.go_on() == "FAILED"


def test_the_error_has_the_slot_the_status_and_the_reason() -> None:
    board, clock = LocalBoard(), ManualClock()
    call = Arrangement([CallAction(GO, Goal())], whiteboard=board, clock=clock)
    call.round()
    board.add_message(GO.status, GoalStanding(1, GoalStatus.ABORTED, "the way is blocked"))
    with pytest.raises(ExecutionError, match="go/goal: the goal was aborted: the way is blocked"):
        call.run(max_rounds=3)


def test_a_silent_server_is_a_failure_and_its_goal_is_canceled() -> None:
    caller = Caller(CallAction(GO, Goal(), timeout_ms=2000))
    assert caller.go_on(1900) == "CALL"
    assert caller.get(GO.cancel) is None
    assert caller.go_on(600) == "FAILED"
    assert caller.get(GO.cancel) == CancelGoal()


@pytest.mark.parametrize("request_", ["suspend", "restart", "unload"])
def test_whoever_ends_it_cancels_its_goal(request_: str) -> None:
    caller = Caller(CallAction(GO, Goal()))
    caller.go_on()
    caller.stand(GoalStatus.EXECUTING)
    caller.go_on()
    getattr(caller.mission, request_)("Mission")
    if request_ != "unload":
        caller.mission.round()
    assert caller.get(GO.cancel) == CancelGoal()


def test_each_goal_has_a_number_of_its_own_and_is_made_when_it_is_sent() -> None:
    made: list[Machine] = []

    def goal(machine: Machine) -> Goal:
        made.append(machine)
        return Goal(x=len(made))

    caller = Caller(CallAction(GO, goal))
    caller.board.add_message(GO.goal, Goal(6))
    caller.board.add_message(GO.status, GoalStanding(6, GoalStatus.SUCCEEDED))
    caller.go_on()
    assert caller.get(GO.goal) == Goal(7, 1.0)
    assert caller.go_on() == "CALL"  # what another goal did does not count


def test_an_answer_is_done_and_a_failure_is_one() -> None:
    for answer, state in ((Answer(1, opened=True), "THERE"), (Answer(1, failure="away"), "FAILED")):
        caller = Caller(CallService(DOOR, Goal(x=3.0)))
        caller.go_on()
        assert caller.get(DOOR.request) == Goal(1, 3.0)
        caller.board.add_message(DOOR.answer, answer)
        assert caller.go_on() == state


def test_a_service_that_does_not_answer_is_a_failure() -> None:
    caller = Caller(CallService(DOOR, Goal(), timeout_ms=1000))
    assert caller.go_on(1500) == "FAILED"


@pytest.mark.parametrize("timeout_ms", [0, -1, True, "5"])
def test_a_time_that_is_none_is_refused(timeout_ms: Any) -> None:
    with pytest.raises(DefinitionError, match=r"timeout_ms is .*; it must be above 0"):
        CallAction(GO, Goal(), timeout_ms=timeout_ms)
