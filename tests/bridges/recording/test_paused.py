"""A run that was paused, with requests meanwhile, is the same when it runs again."""

from __future__ import annotations

import threading
from typing import Any

import pytest

from llfsm.bridges.recording.rerun import Rerun
from llfsm.runtime import ManualClock, OptionError
from llfsm.runtime.debugging import Debugger
from llfsm.runtime.debugging.published_causes import why_of
from llfsm.whiteboard import Whiteboard
from waiting import PATIENCE_S

from .journalled_run import JumpingClock, Run
from .machines import COMMAND, Follower, Keeper, Number


@pytest.mark.parametrize("on_pause", ["keep", "safe"])
@pytest.mark.parametrize("clock", [ManualClock, JumpingClock])
def test_what_was_paused_runs_again(clock: Any, on_pause: Any) -> None:
    """Requests, messages and a stop come before the turns of either machine, also in a round.

    To see why a machine is where it is leaves no trace.
    """
    run = Run([Keeper, Follower], Whiteboard.local(), clock=clock())
    debugger = Debugger(run.arrangement, on_pause=on_pause)
    debugger.pause()
    thread = threading.Thread(target=run.arrangement.run, kwargs={"grace_s": 0.0})
    thread.start()
    debugger.wait(PATIENCE_S)
    asks = [
        lambda: run.board.add_message(COMMAND, Number(9)),
        lambda: run.arrangement.hold("Follower"),
        lambda: run.arrangement.hold("Keeper"),
        lambda: run.arrangement.resume("Follower"),
        lambda: run.board.add_message(COMMAND, Number(3)),
        lambda: run.arrangement.restart("Keeper"),
        lambda: why_of(run.arrangement, "Follower", debugger.now_ns),
        lambda: None,
    ]
    for ask in asks * 3:
        ask()
        debugger.step()
        debugger.wait(PATIENCE_S)
    run.arrangement.stop()
    thread.join()
    assert len(run.trace) > 60
    difference, trace = run.again([Keeper, Follower])
    assert difference is None
    assert trace == run.trace


def test_what_was_overridden_runs_again_and_is_marked() -> None:
    """Also what two sensors find when they are released, and there is no message."""
    run = Run([Keeper, Follower], Whiteboard.local(), clock=JumpingClock())
    arrangement = run.arrangement
    follower = arrangement.machine("Follower")
    for message in (Number(7), None, Number(2)):
        arrangement.override("Follower", "command", message)
        for _ in range(3):
            arrangement.round()
            assert follower.again == message
        arrangement.release("Follower", "again")
        for _ in range(3):
            arrangement.round()
            assert follower.again is None
    arrangement.end()
    marks = [each for each in run.entries if each["event"] in ("Overridden", "Released")]
    assert [each["event"] for each in marks] == ["Overridden", "Released"] * 3
    assert {(each["machine"], each["slot"]) for each in marks} == {("Follower", "command")}
    difference, trace = run.again([Keeper, Follower])
    assert difference is None
    assert trace == run.trace


def test_what_machines_learnt_then_cannot_be_overridden() -> None:
    run = Run([Follower], Whiteboard.local(), clock=ManualClock())
    run.arrangement.round()
    run.arrangement.end()
    again = Rerun(run.entries).arrange([Follower])
    with pytest.raises(OptionError, match="reads 'command' as it was recorded"):
        again.override("Follower", "command", Number(3))
