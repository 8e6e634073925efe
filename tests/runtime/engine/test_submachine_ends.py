"""A called machine is done when it accepts, and has failed when it ends in any other way."""

from __future__ import annotations

from typing import Any

import pytest

from llfsm.runtime import Arrangement, Machine, ManualClock, State
from llfsm.whiteboard import Whiteboard

from .submachines import SAID, Breaks, Counts, Number, Says, Square, Stuck


def test_done_is_told_when_it_accepts_and_its_results_stay():
    arrangement = Arrangement([Counts], clock=ManualClock())
    square = arrangement.call_machine(Square, name="sq", variables={"number": 12})
    seen = []
    for _ in range(6):
        arrangement.round()
        seen.append((square.done, square.failed, square.machine.state_name))
    assert seen[:4] == [(False, False, "thinking")] * 3 + [(False, False, "ready")]
    assert seen[4:] == [(True, False, "ready")] * 2
    assert square.machine.result == 144
    assert (square.name, repr(square)) == ("sq", "<Submachine sq: done>")
    assert len(arrangement.machines) == 1


def test_a_machine_that_is_cancelled_has_failed_and_posts_its_last():
    board = Whiteboard.local()
    arrangement = Arrangement([Counts], whiteboard=board)
    called = arrangement.call_machine(Says)
    arrangement.round()
    called.cancel()
    assert (called.done, called.failed, repr(called)) == (False, True, "<Submachine Says: failed>")
    assert board.get_message(SAID) == Number(-7)
    assert len(arrangement.machines) == 1


def test_cancelling_twice_or_after_the_end_changes_nothing():
    arrangement = Arrangement([Counts], clock=ManualClock())
    first, second = arrangement.call_machine(Stuck), arrangement.call_machine(Square)
    arrangement.round()
    first.cancel()
    again = arrangement.call_machine(Stuck)  # takes the name and the hole
    first.cancel()
    for _ in range(6):
        arrangement.round()
    second.cancel()
    assert (again.failed, arrangement.control.index_of("Stuck")) == (False, 1)
    assert (second.done, second.failed) == (True, False)


def test_one_that_is_unloaded_by_somebody_has_failed():
    arrangement = Arrangement([Counts])
    called = arrangement.call_machine(Stuck)
    arrangement.round()
    arrangement.unload("Stuck")
    assert (called.done, called.failed) == (False, True)


def test_one_that_was_asked_to_stop_and_did_not_has_failed():
    arrangement = Arrangement([Counts], clock=ManualClock())
    called = arrangement.call_machine(Stuck)
    arrangement.stop_machine("Stuck")
    arrangement.run(max_rounds=20, grace_s=0.1)
    assert (called.done, called.failed) == (False, True)


@pytest.mark.parametrize("suspended", [False, True])
def test_one_whose_code_raised_has_failed(suspended: bool):
    arrangement = Arrangement([Counts], clock=ManualClock(), on_error="suspend")

    class BreaksAsleep(Breaks):
        asleep = State(suspend=True)

        @asleep.internal
        def _(self) -> None:
            raise ValueError("bang")

    called = arrangement.call_machine(BreaksAsleep if suspended else Breaks)
    if suspended:
        arrangement.suspend(called.name)
    for _ in range(4):
        arrangement.round()
    assert (called.done, called.failed) == (False, True)


def test_when_all_has_ended_what_was_not_done_has_failed():
    arrangement = Arrangement([Counts], clock=ManualClock())
    stuck, square = arrangement.call_machine(Stuck), arrangement.call_machine(Square)
    arrangement.run(max_rounds=10)
    assert (stuck.failed, square.failed, square.done) == (True, False, True)
    stuck.cancel()


def test_a_suspended_machine_in_an_accepting_state_is_not_done():
    class Rests(Machine):
        a = State()
        asleep = State(suspend=True)

    arrangement = Arrangement([Counts], clock=ManualClock())
    called = arrangement.call_machine(Rests)
    arrangement.suspend("Rests")
    arrangement.round()
    arrangement.round()
    assert (called.done, called.failed) == (False, False)
    arrangement.resume("Rests")
    arrangement.round()
    assert called.done


def test_where_accepting_machines_stay_one_is_done_until_it_is_restarted():
    arrangement = Arrangement([Counts], clock=ManualClock(), unload_accepting=False)
    square = arrangement.call_machine(Square, variables={"number": 5})
    for _ in range(6):
        arrangement.round()
    assert (square.done, square.failed) == (True, False)
    assert len(arrangement.machines) == 2
    arrangement.restart("Square")
    square.machine.patience = 2
    arrangement.round()
    assert (square.done, square.failed) == (False, False)
    for _ in range(4):
        arrangement.round()
    assert square.done
    square.cancel()
    assert (square.done, square.failed) == (True, False)
    assert len(arrangement.machines) == 1


def test_a_caller_may_cancel_one_inside_whose_ringlet_it_runs():
    class Tyrant(Machine):
        caller: str = "Boss"
        a = State()
        b = State()
        a.to(b, when=lambda m: False)

        @a.on_entry
        def _(self) -> None:
            self.abandon(self.caller)  # runs the caller's suspend state in here
            self.caller = self.state_name  # it is still in its own ringlet

    class Boss(Machine):
        called: Any = None
        a = State()
        b = State()
        asleep = State(suspend=True)
        a.to(b, when=lambda m: False)

        @a.on_entry
        def _(self) -> None:
            self.called = self.call_machine(Tyrant)

        @asleep.on_entry
        def _(self) -> None:
            self.called.cancel()

    boss = Boss()
    arrangement = Arrangement([boss, Counts], clock=ManualClock())
    arrangement.round()
    assert boss.called.failed
    assert boss.called.machine.caller == "a"
    assert [machine.name for machine in arrangement.machines] == ["Boss", "Counts"]
