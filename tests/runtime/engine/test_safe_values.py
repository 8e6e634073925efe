"""A robot stops when its machine is suspended, fails or ends: safe values are on the board."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from llfsm.runtime import (
    Actuator,
    ActuatorClosedError,
    Arrangement,
    ExecutionError,
    Machine,
    ManualClock,
    State,
    Trace,
)
from llfsm.runtime.engine.events import Section
from llfsm.whiteboard import Board, Slot, SlotRetiredError, Whiteboard
from llfsm.whiteboard.messages.std_msgs import Int32

DRIVE = Slot("drive", Int32)
GO, SUSPENDED, FAILED, ENDED = (Int32(data=n) for n in (1, 2, 3, 4))
KINDS = {"at_suspend": SUSPENDED, "at_failure": FAILED, "at_end": ENDED}


def mover(**safe: Int32) -> type[Machine]:
    class Mover(Machine):
        drive = Actuator(DRIVE, **safe)
        fails: bool = False
        leaves: bool = False
        seen: tuple[Int32 | None, ...] = ()
        board: Any = None

        going = State()
        parked = State(suspend=True)

        @going.internal
        def _(self) -> None:
            if self.fails:
                raise ValueError("the wheel fell off")
            self.drive(GO)
            if self.leaves:
                self.suspend_self()

        @going.on_suspend
        def _(self) -> None:
            self.seen += (self.board.get_message(DRIVE),)

    return Mover


class Other(Machine):
    does: str = ""
    here = State()

    @here.internal
    def _(self) -> None:
        if self.does == "suspend_all":
            self.suspend_all()
        elif self.does:
            getattr(self, self.does)("Mover")
        self.does = ""


Rig = tuple[Arrangement, Any, Any, Board]


def rig(on_error: Any = "suspend", **safe: Int32) -> Rig:
    board = Whiteboard.local()
    machine = mover(**safe)(board=board)
    other = Other()
    arrangement = Arrangement(
        [machine, other],
        whiteboard=board,
        clock=ManualClock(),
        on_error=on_error,
        unload_accepting=False,
    )
    arrangement.round()
    assert board.get_message(DRIVE) == GO
    return arrangement, machine, other, board


def suspend_from_outside(arrangement: Arrangement, machine: Any, other: Any) -> None:
    arrangement.suspend("Mover")
    arrangement.round()


def hold(arrangement: Arrangement, machine: Any, other: Any) -> None:
    arrangement.control.hold("Mover")
    arrangement.round()


def suspend_self(arrangement: Arrangement, machine: Any, other: Any) -> None:
    machine.leaves = True
    arrangement.round()
    arrangement.round()


def by_another(does: str) -> Any:
    def act(arrangement: Arrangement, machine: Any, other: Any) -> None:
        other.does = does
        arrangement.round()
        arrangement.round()

    act.__name__ = does
    return act


WAYS = [
    suspend_from_outside,
    hold,
    suspend_self,
    *map(by_another, ("suspend", "suspend_all", "abandon")),
]


@pytest.mark.parametrize("way", WAYS)
def test_however_it_is_suspended_the_safe_value_is_there_before_on_suspend(way: Any) -> None:
    arrangement, machine, other, board = rig(**KINDS)
    way(arrangement, machine, other)
    assert arrangement.is_suspended("Mover")
    assert machine.seen == (SUSPENDED,)
    assert board.get_message(DRIVE) == SUSPENDED
    count = board[DRIVE].count
    arrangement.round()
    assert board[DRIVE].count == count  # once
    arrangement.resume("Mover")
    arrangement.round()
    assert board.get_message(DRIVE) == GO


def test_a_failure_posts_its_value_which_stays() -> None:
    arrangement, machine, _, board = rig(**KINDS)
    machine.fails = True
    arrangement.round()
    assert board.get_message(DRIVE) == FAILED
    for _ in range(3):
        arrangement.round()
    assert arrangement.is_suspended("Mover")
    assert board.get_message(DRIVE) == FAILED
    arrangement.end()
    assert board.get_message(DRIVE) == ENDED


def test_a_failure_that_stops_all_posts_both() -> None:
    arrangement, machine, _, board = rig("stop", **KINDS)
    machine.fails = True
    with pytest.raises(ExecutionError):
        arrangement.round()
    assert board.get_message(DRIVE) == ENDED
    assert board[DRIVE].count == 3  # go, failed, ended


@given(st.sets(st.sampled_from(sorted(KINDS))))
def test_what_is_not_given_is_what_stands_below(given_: set[str]) -> None:
    actuator = Actuator(DRIVE, **{kind: KINDS[kind] for kind in given_})
    at_suspend = SUSPENDED if "at_suspend" in given_ else actuator.at_end
    assert actuator.at_end == (ENDED if "at_end" in given_ else None)
    assert actuator.at_suspend == at_suspend
    assert actuator.at_failure == (FAILED if "at_failure" in given_ else at_suspend)


def test_with_at_end_alone_all_three_stop_it_and_a_failing_end_posts_it_once() -> None:
    arrangement, machine, _, board = rig("stop", at_end=ENDED)
    machine.fails = True
    with pytest.raises(ExecutionError):
        arrangement.round()
    assert (board.get_message(DRIVE), board[DRIVE].count) == (ENDED, 2)
    arrangement, machine, _, board = rig(at_end=ENDED)
    arrangement.suspend("Mover")
    arrangement.round()
    assert board.get_message(DRIVE) == ENDED


def test_without_safe_values_nothing_is_posted_and_the_events_are_the_same() -> None:
    def run(**safe: Int32) -> tuple[Trace, int]:
        arrangement, machine, other, board = rig(**safe)
        trace = Trace()
        arrangement.attach(trace)
        other.does = "suspend"
        for _ in range(4):
            arrangement.round()
        arrangement.resume("Mover")
        arrangement.round()
        machine.fails = True
        arrangement.round()
        arrangement.end()
        return Trace(e for e in trace if isinstance(e, Section)), board[DRIVE].count

    (plain, count), (safe, more) = run(), run(**KINDS)
    assert plain == safe
    assert more == count + 3


def test_a_board_that_is_closed_hinders_no_other_safe_value(
    caplog: pytest.LogCaptureFixture,
) -> None:
    arrangement, _, _, board = rig(**KINDS)
    arrangement.suspend("Mover")
    board.close()
    arrangement.round()
    assert "the safe value of drive was not posted" in caplog.text


@pytest.mark.parametrize("shared", [True, False])
def test_a_thread_of_a_section_cannot_post_after_the_end(tmp_path: Path, shared: bool) -> None:
    failures: list[Exception] = []
    go_on = threading.Event()

    class Threaded(Machine):
        drive = Actuator(DRIVE, at_end=ENDED)
        here = State()

        @here.on_entry
        def _(self) -> None:
            kept = self.drive

            def late() -> None:
                go_on.wait()
                for post in (self.drive, kept):
                    try:
                        post(GO)
                    except Exception as error:
                        failures.append(error)

            self.thread = threading.Thread(target=late)
            self.thread.start()

    board = Whiteboard(f"retired-{tmp_path.name}") if shared else Whiteboard.local()
    machine = Threaded()
    with Arrangement([machine], whiteboard=board) as arrangement:
        arrangement.round()
    go_on.set()
    machine.thread.join()
    assert [type(failure) for failure in failures] == [ActuatorClosedError, SlotRetiredError]
    assert "Threaded has ended and cannot post to 'drive'" in str(failures[0])
    assert board.get_message(DRIVE) == ENDED
    board.remove()


def test_what_a_failed_machine_posts_in_its_suspend_state_does_not_outlive_the_end() -> None:
    class Limps(Machine):
        drive = Actuator(DRIVE, at_end=ENDED)

        going = State()
        creeping = State(suspend=True)

        @going.on_entry
        def _(self) -> None:
            raise ValueError("the wheel fell off")

        @creeping.internal
        def _(self) -> None:
            self.drive(GO)

    board = Whiteboard.local()
    arrangement = Arrangement([Limps, Other], whiteboard=board, on_error="suspend")
    arrangement.round()
    assert board.get_message(DRIVE) == ENDED
    arrangement.round()
    assert board.get_message(DRIVE) == GO
    arrangement.end()
    assert board.get_message(DRIVE) == ENDED


def test_code_that_raises_after_the_end_is_reported_as_itself() -> None:
    class EndsAll(Machine):
        drive = Actuator(DRIVE, **KINDS)

        only = State()

        @only.on_entry
        def _(self) -> None:
            arrangement.end()
            raise ValueError("too late")

    board = Whiteboard.local()
    arrangement = Arrangement([EndsAll], whiteboard=board)
    with pytest.raises(ExecutionError, match="ValueError: too late"):
        arrangement.round()
    assert board.get_message(DRIVE) == ENDED
    assert board[DRIVE].count == 1
