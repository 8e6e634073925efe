"""The queue of missions: what is accepted, in which order it is run, and how each ends."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from llfsm.machines.mission_queue import (
    MISSION_ANSWER,
    MISSION_CANCEL,
    MISSION_REQUEST,
    MISSION_STANDING,
    CancelMission,
    MissionAnswer,
    MissionEnd,
    MissionQueue,
    MissionRequest,
    MissionStanding,
)
from llfsm.runtime import Arrangement, DefinitionError, Machine, ManualClock, Reason, State
from llfsm.whiteboard.local import LocalBoard


class Short(Machine):
    """Take half a second."""

    WORK = State()
    DONE = State()
    WORK.to(DONE, after_ms=500)


class Breaks(Machine):
    """Fail after a while."""

    WORK = State()
    BROKEN = State()
    WORK.to(BROKEN, after_ms=200)

    @BROKEN.on_entry
    def _(self) -> None:
        raise ValueError("no way")


class Endless(Machine):
    """Go on until it is ended."""

    WORK = State()
    END = State()
    WORK.to(END, when=lambda self: self.stopping)


QUEUE = MissionQueue(short=Short, breaks=Breaks, endless=Endless, capacity=3)


class Run:
    """The queue in simulated time, a turn every 50 ms."""

    def __init__(self) -> None:
        self.clock = ManualClock()
        self.board = LocalBoard(now_ns=self.clock.now_ns)
        self.board.add_message(MISSION_REQUEST, MissionRequest("old", "short"))
        self.arrangement = Arrangement([QUEUE], whiteboard=self.board, clock=self.clock)
        self.seen: list[MissionStanding] = []
        self.board[MISSION_STANDING].on_add(self.note)
        self.go_on()

    def note(self, _: int) -> None:
        self.seen.append(self.standing)

    def go_on(self, ms: float = 100) -> str:
        for _ in range(round(ms / 50)):
            self.arrangement.round()
            self.clock.advance(ms=50)
        return self.arrangement.states().get("MissionQueue", "")

    def ask(self, id_: str, mission: str) -> MissionAnswer:
        self.board.add_message(MISSION_REQUEST, MissionRequest(id_, mission))
        for _ in range(5):  # where one mission ends and the next begins, it is not looked at
            self.go_on(50)
            answer = self.board.get_message(MISSION_ANSWER)
            if answer is not None and answer.id == id_:
                return answer
        raise AssertionError(f"no answer to {id_}: {answer}")

    @property
    def standing(self) -> MissionStanding:
        return self.board.get_message(MISSION_STANDING) or MissionStanding()


def test_missions_are_run_in_order_and_what_becomes_of_each_is_reported() -> None:
    run = Run()
    assert run.board.get_message(MISSION_ANSWER) is None  # for the request from before
    assert run.ask("a", "short") == MissionAnswer("a", True, 1)
    assert run.go_on() == "RUN_SHORT"
    assert run.standing == MissionStanding("short", "a")
    assert run.ask("b", "breaks") == MissionAnswer("b", True, 1)
    assert run.standing == MissionStanding("short", "a")
    run.go_on(1500)
    assert [(each.mission, each.id) for each in run.seen if each.id] == [
        ("short", "a"),
        ("breaks", "b"),
    ]
    assert (run.standing.ended, run.standing.end) == ("b", MissionEnd.FAILED)
    assert "no way" in run.standing.reason
    assert run.go_on() == "IDLE"


def test_what_cannot_be_run_is_refused_with_the_reason() -> None:
    run = Run()
    refused = run.ask("x", "dance")
    assert refused == MissionAnswer(
        "x", False, 0, "no mission 'dance'; there are: short, breaks, endless"
    )
    run.ask("a", "endless")
    run.go_on()
    places = [run.ask(each, "short").place for each in "bcd"]
    assert places == [1, 2, 3]
    assert run.ask("e", "short").reason == "3 missions wait already"
    run.board.add_message(MISSION_CANCEL, CancelMission("d"))
    run.go_on()
    again = run.ask("b", "short")
    assert not again.accepted
    assert "needs an id of its own" in again.reason


def test_what_runs_or_waits_can_be_canceled() -> None:
    run = Run()
    run.ask("a", "endless")
    run.go_on()
    run.ask("b", "short")
    run.ask("c", "short")
    run.board.add_message(MISSION_CANCEL, CancelMission("b"))
    run.go_on()
    expected = MissionStanding("endless", "a", ("c",), "b", MissionEnd.CANCELED)
    assert run.standing == expected
    run.board.add_message(MISSION_CANCEL, CancelMission("a"))
    run.go_on(200)
    assert (run.standing.mission, run.standing.id) == ("short", "c")
    assert "MissionQueue/Endless" not in run.arrangement.states()


def test_a_mission_goes_on_after_a_suspension() -> None:
    run = Run()
    run.ask("a", "endless")
    run.ask("b", "short")
    run.arrangement.suspend("MissionQueue")
    run.go_on()
    run.arrangement.resume("MissionQueue")
    assert run.go_on() == "RUN_ENDLESS"
    assert run.standing == MissionStanding("endless", "a", ("b",))
    run.board.add_message(MISSION_CANCEL, CancelMission("a"))
    run.go_on(200)
    assert run.standing.id == "b"


def test_a_restart_cancels_what_runs_and_keeps_what_waits() -> None:
    run = Run()
    run.ask("a", "endless")
    run.ask("b", "short")
    run.arrangement.restart("MissionQueue")
    run.go_on(200)
    ended = [each for each in run.seen if each.ended]
    assert [(each.ended, each.end) for each in ended] == [("a", MissionEnd.CANCELED)]
    assert run.standing.id == "b"


def test_a_stop_ends_what_runs() -> None:
    run = Run()
    run.ask("a", "endless")
    run.go_on()
    run.arrangement.stop()
    assert run.arrangement.run() is Reason.ACCEPTING
    assert run.standing == MissionStanding()


@given(
    steps=st.lists(
        st.tuples(
            st.sampled_from(["ask", "cancel", "wait", "pause", "restart"]),
            st.integers(0, 5),
            st.sampled_from(["short", "breaks", "endless", "none"]),
        ),
        max_size=25,
    )
)
def test_each_mission_that_was_accepted_ends_once_and_in_order(steps: list[Any]) -> None:
    run = Run()
    accepted: list[str] = []
    for number, (verb, argument, mission) in enumerate(steps):
        if verb == "ask" and run.ask(f"m{number}", mission).accepted:
            accepted.append(f"m{number}")
        elif verb == "cancel" and argument < len(accepted):
            run.board.add_message(MISSION_CANCEL, CancelMission(accepted[argument]))
        elif verb == "pause":
            run.arrangement.suspend("MissionQueue")
            run.go_on(50 * argument)
            run.arrangement.resume("MissionQueue")
        elif verb == "restart":
            run.arrangement.restart("MissionQueue")
        run.go_on(100 * argument)
        assert len(run.standing.waiting) <= 3
    for each in accepted:  # the endless ones would keep the others waiting
        run.board.add_message(MISSION_CANCEL, CancelMission(each))
        run.go_on(300)
    ended = dict.fromkeys(each.ended for each in run.seen if each.ended)
    begun = dict.fromkeys(each.id for each in run.seen if each.id)
    assert sorted(ended) == sorted(accepted)
    assert [*begun] == [each for each in accepted if each in begun]


def test_a_queue_of_nothing_is_an_error() -> None:
    with pytest.raises(DefinitionError, match="give it missions, as round=Patrol"):
        MissionQueue()
    with pytest.raises(DefinitionError, match="capacity is 0; it must be 1 or more"):
        MissionQueue(short=Short, capacity=0)
