"""What is requested on a whiteboard is done as if it were requested in the process."""

from __future__ import annotations

from typing import Any

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from llfsm.runtime import Arrangement, ManualClock, Reason, Status, Trace
from llfsm.runtime.engine.events import RoundEnd, Section
from llfsm.runtime.presence.remote import Directory
from llfsm.whiteboard import Board, Whiteboard
from thoroughness import examples

from .machines import Clock, Idle, Obedient, Spins, Steps, Target, ask, status_of

requests = st.lists(
    st.tuples(st.integers(0, 12), st.sampled_from(["suspend", "resume", "restart"])), max_size=8
)


def traced(
    requested: list[tuple[int, Any]], board: Board | None, **how: Any
) -> tuple[Trace, list[Status]]:
    """Run a machine of which something is requested at some sleeps, there or here."""
    trace, answers = Trace(), []

    def look(sleeps: int) -> None:
        for at, action in requested:
            if at == sleeps:
                if board is None:
                    answers.append(getattr(arrangement, action)("Target"))
                else:
                    answers.append(Directory(board).find("Target").request(action))

    clock = Clock(look)
    arrangement = Arrangement(
        [Idle, Target], whiteboard=board, clock=clock, observers=[trace], **how
    )
    arrangement.run(max_rounds=25)
    return trace, answers


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=examples(20))
@given(requests, st.sampled_from([{}, {"period_us": 10_000}]))
def test_what_is_asked_through_the_board_is_done_as_if_asked_here(
    requested: list[tuple[int, str]], schedule: dict[str, Any]
):
    here = traced(requested, None, **schedule)
    there = traced(requested, Whiteboard.local(), **schedule)
    assert there == here


def test_a_request_takes_effect_at_the_next_turn(board: Board):
    trace, answers = traced([(2, "suspend"), (6, "resume"), (8, "restart")], board)
    assert answers == [Status.RUNNING, Status.SUSPENDED, Status.RUNNING]
    sections = [s for s in trace.sections() if s[1] == "Target" and s[2] != "Internal"]
    assert sections[:3] == [
        (1, "Target", "OnEntry", "a"),
        (4, "Target", "OnSuspend", "a"),
        (4, "Target", "OnEntry", "asleep"),
    ]


def test_the_last_request_wins(board: Board):
    trace, answers = traced([(2, "restart"), (2, "suspend")], board)
    assert answers == [Status.RUNNING, Status.RUNNING]
    turns = [event for event in trace if isinstance(event, Section) and event.machine == "Target"]
    assert turns[-1].state == "asleep"


def test_a_resume_after_a_pending_restart_is_refused_and_the_restart_stays(board: Board):
    _, answers = traced([(2, "suspend"), (4, "restart"), (4, "resume"), (5, "resume")], board)
    assert answers == [Status.RUNNING, Status.SUSPENDED, Status.ERROR, Status.RUNNING]


def test_a_pending_request_is_reported(board: Board):
    seen = []

    def look(sleeps: int) -> None:
        if sleeps == 0:
            arrangement.suspend("Idle")
        elif sleeps < 5:
            seen.append((status_of(board, "Idle").pending, status_of(board, "Idle").suspended))

    arrangement = Arrangement([Idle, Obedient], whiteboard=board, clock=Clock(look), idle_us=50_000)
    arrangement.run(max_rounds=3)
    assert seen == [("suspend", False), ("suspend", False), ("", True), ("", True)]


def test_requests_from_before_the_start_are_ignored(board: Board):
    ask(board, "Idle", "suspend")
    ask(board, "Steps", "stop")

    def look(sleeps: int) -> None:
        assert not arrangement.is_suspended("Idle")
        if sleeps == 3:
            ask(board, "Other", "stop")  # whereupon everybody looks

    arrangement = Arrangement([Idle, Steps], whiteboard=board, clock=Clock(look))
    arrangement.run(max_rounds=200)
    assert len(arrangement.machines) == 2


def test_a_request_to_somebody_else_changes_nothing(board: Board):
    clock = Clock(lambda sleeps: ask(board, "Other", "suspend") if sleeps == 1 else None)
    arrangement = Arrangement([Idle], whiteboard=board, clock=clock)
    arrangement.run(max_rounds=5)
    assert not arrangement.is_suspended("Idle")
    assert status_of(board, "Idle").obeyed == 0


def test_rounds_that_never_rest_obey_too(board: Board):
    trace = Trace()
    arrangement = Arrangement([Spins, Idle], whiteboard=board, clock=ManualClock())
    arrangement.attach(trace)
    arrangement.attach(
        lambda event: (
            isinstance(event, RoundEnd)
            and arrangement.rounds == 10
            and ask(board, "Idle", "suspend")
        )
    )
    arrangement.run(max_rounds=12)
    assert [s for s in trace.sections() if s[1] == "Idle" and s[2] == "OnSuspend"] == [
        (11, "Idle", "OnSuspend", "a")
    ]


def test_a_machine_suspended_from_outside_keeps_its_process_for_the_resume(board: Board):
    def look(sleeps: int) -> None:
        if sleeps == 2:
            ask(board, "Idle", "suspend")
        if sleeps == 500:
            assert arrangement.is_suspended("Idle")
            ask(board, "Idle", "resume")
        if sleeps == 510:
            assert not arrangement.is_suspended("Idle")
            arrangement.suspend("Idle")  # from inside: nobody else would resume it

    arrangement = Arrangement([Idle], whiteboard=board, clock=Clock(look))
    assert arrangement.run(max_rounds=1_000) is Reason.ACCEPTING
    assert arrangement.rounds < 520


def test_a_stop_ends_an_arrangement_whose_machine_is_suspended_from_outside(board: Board):
    def look(sleeps: int) -> None:
        if sleeps == 2:
            ask(board, "Idle", "suspend")
        if sleeps == 10:
            arrangement.stop()

    arrangement = Arrangement([Idle], whiteboard=board, clock=Clock(look))
    assert arrangement.run(max_rounds=1_000) is Reason.ACCEPTING
    assert arrangement.rounds < 20
