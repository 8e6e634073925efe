"""A paused arrangement gives no turn, but is there for others; steps are as long as they say."""

from __future__ import annotations

import itertools
import logging
import time
from pathlib import Path
from types import SimpleNamespace

import pytest

from llfsm.runtime import (
    Arrangement,
    ArrangementEndedError,
    ManualClock,
    NotPausedError,
    OptionError,
    Trace,
)
from llfsm.runtime.debugging import Debugger, leases
from llfsm.runtime.engine import clock
from llfsm.runtime.engine.clock import DebugClock
from llfsm.runtime.engine.events import Eval, Section
from llfsm.runtime.presence.remote import Directory
from llfsm.whiteboard import Whiteboard
from llfsm.whiteboard.messages.llfsm import MachineRequest, status_slot
from waiting import PATIENCE_S, wait_for

from .machines import DRIVE, Counter, Driver, running, stopped_at, turns


def test_a_step_is_a_turn() -> None:
    trace = Trace()
    arrangement = Arrangement([Counter, Driver], clock=ManualClock(), whiteboard=Whiteboard.local())
    arrangement.attach(trace)
    with running(arrangement) as debugger:
        for _ in range(5):
            before = len(turns(trace))
            turn = stopped_at(debugger)
            assert len(turns(trace)) == before + 1
            assert turns(trace)[-1] == (turn.round, turn.machine)
            assert isinstance(trace[-1], type(turn)), "nothing of the turn was done"
    assert turns(trace)[:4] == [(1, "Counter"), (1, "Driver"), (2, "Counter"), (2, "Driver")]


def test_a_step_is_the_rest_of_a_round() -> None:
    with running(Arrangement([Counter, Counter], clock=ManualClock())) as debugger:
        assert stopped_at(debugger)[:4:3] == (1, "Counter.0")
        assert stopped_at(debugger, until="round")[:4:3] == (2, "Counter")
        assert stopped_at(debugger, until="round")[:4:3] == (3, "Counter")


def test_a_step_is_until_a_transition_has_fired() -> None:
    trace = Trace()
    arrangement = Arrangement([Counter, Counter], clock=ManualClock(), observers=[trace])
    with running(arrangement) as debugger:
        for number in (1, 2, 3):
            stopped_at(debugger, until="transition")
            fired = [event for event in trace if isinstance(event, Eval) and event.value]
            assert len(fired) == number
            last = [event for event in trace if isinstance(event, Section)][-1]
            assert last.section == "OnExit", "it is paused right after that turn"


def test_a_step_is_until_a_machine_leaves_its_state() -> None:
    arrangement = Arrangement([Counter, Counter], clock=ManualClock())
    with running(arrangement) as debugger:
        for state in ("high", "low"):
            stopped_at(debugger, until="leave", machine="Counter.0")
            assert arrangement.state_name_of("Counter.0") == state
            assert debugger.paused.startswith("step: Counter.0 left ")


def test_what_is_no_step_is_refused() -> None:
    with running(Arrangement([Counter], clock=ManualClock())) as debugger:
        with pytest.raises(OptionError, match="no step 'over'; there are: turn, round"):
            debugger.step("over")  # type: ignore[arg-type]
        assert debugger.paused
    with pytest.raises(OptionError, match="on_pause"):
        Debugger(Arrangement(), on_pause="hold")  # type: ignore[arg-type]


def test_what_waits_for_a_pause_gets_the_reason_or_an_error() -> None:
    arrangement = Arrangement([Counter], clock=ManualClock())
    with running(arrangement) as debugger:
        assert debugger.wait(0) == "pause"
        debugger.break_at("Counter:high")
        debugger.step("round")
        assert debugger.wait(PATIENCE_S) == "step: round"
        debugger.break_at()
        debugger.proceed()
        with pytest.raises(NotPausedError, match="not paused within 0"):
            debugger.wait(0.001)
        arrangement.stop()
        with pytest.raises(ArrangementEndedError, match="has ended, not paused: stopped"):
            debugger.wait(PATIENCE_S)


def test_turns_cost_nothing_more_before_and_after_a_pause() -> None:
    arrangement = Arrangement([Counter], clock=ManualClock())
    found = Debugger(arrangement)
    assert not arrangement.kernel.observers
    with running(arrangement):
        assert [*arrangement.kernel.observers] == [found]
        found.proceed()
        wait_for(lambda: not arrangement.kernel.observers)


def test_while_paused_statuses_are_published_and_requests_obeyed() -> None:
    board = Whiteboard.local()
    arrangement = Arrangement([Counter, Driver], clock=ManualClock(), whiteboard=board)
    with running(arrangement) as debugger:
        slot = board[status_slot("Driver")]
        wait_for(lambda: slot.get().paused == "pause")
        assert Directory(board).find("Driver").condition == "paused"
        before = slot.count
        wait_for(lambda: slot.count > before + 2, "a heartbeat, though the clock stands still")
        Directory(board).find("Driver").request("suspend")
        wait_for(lambda: slot.get().pending == "suspend", "the request is seen")
        assert arrangement.state_name_of("Driver") == "going"
        stopped_at(debugger, until="round")
        assert arrangement.state_name_of("Driver") == "Suspended"
        debugger.proceed()
        wait_for(lambda: not slot.get().paused, "it goes on")


def test_other_processes_pause_step_and_continue() -> None:
    board = Whiteboard.local()
    arrangement = Arrangement([Driver], clock=ManualClock(), whiteboard=board)
    with running(arrangement) as debugger:
        machine = Directory(board).find("Driver")
        debugger.proceed()
        machine.send(MachineRequest("pause", lease_s=1000.0))
        assert debugger.wait(PATIENCE_S) == "pause"
        machine.send(MachineRequest("step", "round", 1000.0))
        wait_for(lambda: debugger.paused == "step: round")
        machine.send(MachineRequest("continue"))
        wait_for(lambda: not debugger.paused)


def test_a_wrong_step_from_outside_is_logged(caplog: pytest.LogCaptureFixture) -> None:
    board = Whiteboard.local()
    with running(Arrangement([Driver], clock=ManualClock(), whiteboard=board)) as debugger:
        Directory(board).find("Driver").send(MachineRequest("step", "over"))
        wait_for(lambda: "step was not obeyed: Driver: no step 'over'" in caplog.text)
        assert debugger.paused


def test_a_pause_ends_with_its_lease(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    now, looks = [0.0], [0]

    def look() -> float:
        looks[0] += 1
        return now[0]

    monkeypatch.setattr(leases, "time", SimpleNamespace(monotonic=look))
    arrangement = Arrangement([Counter], clock=ManualClock())
    with running(arrangement) as found:
        found.proceed()
        found.pause("by a page", lease_s=10.0)
        found.wait(PATIENCE_S)
        now[0] = 9.0
        found.pause("by a page", lease_s=10.0)
        found.pause("by a page", lease_s=1.0)  # another one's, which shortens none
        rounds, now[0] = arrangement.rounds, 18.0
        before = looks[0]
        wait_for(lambda: looks[0] > before + 2, "the pause looks whether it is over")
        assert (arrangement.rounds, found.paused) == (rounds, "by a page")
        with caplog.at_level(logging.WARNING):
            now[0] = 19.5
            wait_for(lambda: arrangement.rounds > rounds, "the machines go on")
        assert not found.paused
        assert "nobody has renewed the pause (by a page): the machines go on" in caplog.text


def test_a_stop_ends_a_pause() -> None:
    arrangement = Arrangement([Driver], clock=ManualClock(), whiteboard=Whiteboard.local())
    with running(arrangement) as debugger:
        arrangement.stop()
        wait_for(lambda: arrangement.reason)
    assert not debugger.paused
    assert not arrangement.kernel.observers


def test_a_board_that_is_removed_ends_a_pause(tmp_path: Path) -> None:
    with Whiteboard("board", directory=tmp_path) as board:
        arrangement = Arrangement([Driver], whiteboard=board)
        with running(arrangement):
            Whiteboard("board", directory=tmp_path).remove()
            wait_for(lambda: arrangement.reason)


def test_safe_values_are_posted_when_a_pause_begins() -> None:
    board = Whiteboard.local()
    arrangement = Arrangement([Driver], clock=ManualClock(), whiteboard=board)
    Debugger(arrangement, on_pause="safe")
    with running(arrangement) as debugger:
        wait_for(lambda: board[DRIVE].count == 1)
        debugger.step("round")
        wait_for(lambda: board[DRIVE].count == 3, "OnEntry, and again the safe value")
        assert board[DRIVE].get().data == 0


def test_a_debug_clock_stands_still_while_stopped(monkeypatch: pytest.MonkeyPatch) -> None:
    host = itertools.count(0, 5)
    monkeypatch.setattr(clock, "time", SimpleNamespace(monotonic_ns=lambda: next(host)))
    found = DebugClock()
    assert [found.now_ns(), found.now_ns()] == [0, 5]
    with found.stopped():
        assert [found.now_ns(), found.now_ns()] == [10, 10]
        next(host)
    assert [found.now_ns(), found.now_ns()] == [15, 20]


def test_the_clock_of_a_paused_arrangement_stands_still() -> None:
    time_of = DebugClock()
    arrangement = Arrangement([Driver], clock=time_of, whiteboard=Whiteboard.local())
    with running(arrangement) as debugger:
        stopped_at(debugger)
        now_ns, host_ns = time_of.now_ns(), time.monotonic_ns()
        wait_for(lambda: time.monotonic_ns() > host_ns + 1_000_000)
        assert time_of.now_ns() == now_ns
        stopped_at(debugger)
        assert time_of.now_ns() > now_ns
