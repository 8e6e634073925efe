"""After its end, however it comes, an arrangement has no machine on its whiteboard."""

from __future__ import annotations

from typing import Any

import pytest

from llfsm.runtime import (
    Arrangement,
    ArrangementEndedError,
    ExecutionError,
    Machine,
    ManualClock,
    Reason,
    State,
)
from llfsm.whiteboard import Board

from .machines import Clock, Idle, Obedient, Spins, Steps, status_of


def test_no_machine_is_loaded_after_a_run_that_ended_by_itself(board: Board):
    arrangement = Arrangement([Idle, Steps], whiteboard=board, clock=ManualClock())
    arrangement.suspend("Idle")
    arrangement.suspend("Steps")
    assert arrangement.run() is Reason.ACCEPTING
    assert [status_of(board, name).loaded for name in ("Idle", "Steps")] == [False, False]


@pytest.mark.parametrize("idle", [False, True])
def test_no_machine_is_loaded_after_an_end_in_a_round(board: Board, idle: bool):
    arrangement = Arrangement([Idle if idle else Spins], whiteboard=board, clock=ManualClock())
    arrangement.attach(lambda event: arrangement.rounds == 3 and arrangement.end())
    assert arrangement.run() is Reason.CLOSED
    assert status_of(board, "Idle" if idle else "Spins").loaded is False


def test_no_machine_is_loaded_after_an_interruption(board: Board):
    def look(sleeps: int) -> None:
        if sleeps == 3:
            raise KeyboardInterrupt

    arrangement = Arrangement([Idle], whiteboard=board, clock=Clock(look))
    with pytest.raises(KeyboardInterrupt):
        arrangement.run()
    assert status_of(board, "Idle").loaded is False


def test_no_machine_is_loaded_after_code_of_one_raised(board: Board):
    class Fails(Machine):
        a = State()
        b = State()
        a.to(b, after_ms=50)

        @b.on_entry
        def _(self) -> None:
            raise ValueError("bang")

    arrangement = Arrangement([Fails, Idle], whiteboard=board, clock=ManualClock())
    with pytest.raises(ExecutionError):
        arrangement.run()
    assert [status_of(board, name).loaded for name in ("Fails", "Idle")] == [False, False]


def test_a_run_that_is_refused_reports_no_machine(board: Board):
    arrangement = Arrangement([Idle], whiteboard=board, clock=ManualClock())
    arrangement.run(max_rounds=2)
    with pytest.raises(ArrangementEndedError):
        arrangement.run()
    assert status_of(board, "Idle").loaded is False


@pytest.mark.parametrize("schedule", [{}, {"period_us": 20_000}])
def test_a_board_that_is_closed_meanwhile_stops_the_run(board: Board, schedule: dict[str, Any]):
    clock = Clock(lambda sleeps: board.close() if sleeps == 3 else None)
    arrangement = Arrangement([Obedient], whiteboard=board, clock=clock, **schedule)
    assert arrangement.run() is Reason.ACCEPTING
    assert arrangement.stop_cause == "the whiteboard was closed or removed"
