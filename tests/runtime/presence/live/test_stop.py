"""A machine that is stopped alone has its grace period, and the others go on."""

from __future__ import annotations

from typing import Any

import pytest

from llfsm.runtime import Arrangement, Machine, Reason, State, TimeSlot, Timetable, Trace
from llfsm.runtime.engine.events import Accepting
from llfsm.whiteboard import Board
from llfsm.whiteboard.messages.llfsm import VIEWER, Viewer

from .machines import Clock, Idle, Obedient, Steps, ask, status_of

SCHEDULES: dict[str, dict[str, Any]] = {
    "round robin": {},
    "period": {"period_us": 10_000},
    "timetable": {
        "timetable": Timetable([TimeSlot(name, 0, 9) for name in ("M", "Steps")], 10_000)
    },
}


@pytest.mark.parametrize("schedule", SCHEDULES)
@pytest.mark.parametrize("there", [False, True])
def test_a_machine_that_does_not_stop_is_unloaded_after_the_grace_period(
    board: Board, schedule: str, there: bool
):
    gone_ms = []

    def look(sleeps: int) -> None:
        if sleeps == 10:
            if there:
                ask(board, "M", "stop")
            else:
                arrangement.stop_machine("M")
        if len(arrangement.machines) == 1:
            gone_ms.append(clock.now_ns() / 1e6)

    clock, idle = Clock(look), Idle()
    arrangement = Arrangement(whiteboard=board, clock=clock, **SCHEDULES[schedule])
    arrangement.load(idle, name="M")
    arrangement.load(Steps)
    assert arrangement.run(grace_s=0.5, max_rounds=120) is Reason.MAX_ROUNDS
    assert idle.saw_stopping > 10
    assert gone_ms[0] == pytest.approx(600, abs=15)
    assert [machine.name for machine in arrangement.machines] == ["Steps"]
    assert arrangement.stopping is False
    assert status_of(board, "M").loaded is False


def test_a_machine_that_stops_accepts_and_others_see_nothing(board: Board):
    idle, trace = Idle(), Trace()
    clock = Clock(lambda sleeps: ask(board, "Obedient", "stop") if sleeps == 3 else None)
    arrangement = Arrangement([Obedient, idle], whiteboard=board, clock=clock, observers=[trace])
    arrangement.run(max_rounds=200)
    (accepted,) = (event for event in trace if isinstance(event, Accepting))
    assert (accepted.round, accepted.machine, accepted.action) == (6, "Obedient", "unloaded")
    assert idle.saw_stopping == 0
    assert status_of(board, "Obedient").loaded is False


def test_who_watches_a_machine_that_is_stopped_between_two_posts_ends_no_other(board: Board):
    clock = Clock(lambda sleeps: None)

    class Busy(Machine):
        """Fire in each turn, so that no sleep follows a round, which takes a millisecond."""

        turns: int = 0
        only = State()

        @only.to(only)
        def tick(self) -> bool:
            self.turns += 1
            clock.advance(ms=1)
            board.add_message(VIEWER, Viewer(1, why=True))
            if self.turns == 110:  # statuses were posted less than 20 ms ago
                ask(board, "Obedient", "stop")
            return True

    arrangement = Arrangement([Obedient, Busy], whiteboard=board, clock=clock)
    assert arrangement.run(max_rounds=300) is Reason.MAX_ROUNDS
    assert status_of(board, "Obedient").loaded is False


def test_a_suspended_machine_that_is_asked_to_stop_is_unloaded_too(board: Board):
    def look(sleeps: int) -> None:
        if sleeps == 2:
            ask(board, "Obedient", "suspend")
        if sleeps == 4:
            ask(board, "Obedient", "stop")

    arrangement = Arrangement([Obedient, Steps], whiteboard=board, clock=Clock(look))
    arrangement.run(max_rounds=200, grace_s=0.3)
    assert [machine.name for machine in arrangement.machines] == ["Steps"]


def test_when_the_last_machine_was_stopped_the_run_ends(board: Board):
    clock = Clock(lambda sleeps: ask(board, "Idle", "stop") if sleeps == 3 else None)
    arrangement = Arrangement([Idle], whiteboard=board, clock=clock)
    assert arrangement.run(grace_s=0.2) is Reason.ACCEPTING
    assert clock.now_ns() / 1e6 == pytest.approx(240, abs=25)
