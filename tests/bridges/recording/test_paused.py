"""A run that was paused, with requests meanwhile, is the same when it runs again."""

from __future__ import annotations

import threading
import time
from pathlib import Path
from typing import Any

import pytest

from llfsm.bridges.recording.page import RecordedSource
from llfsm.bridges.recording.reader import Recording
from llfsm.bridges.recording.rerun import Rerun
from llfsm.bridges.recording.reversing.reverse_debugger import ReverseDebugger
from llfsm.bridges.recording.writer import RecordingWriter
from llfsm.runtime import ManualClock, OptionError
from llfsm.runtime.debugging import Debugger
from llfsm.runtime.debugging.obeying import why_of
from llfsm.runtime.engine.clock import DebugClock
from llfsm.whiteboard import Whiteboard
from waiting import PATIENCE_S, wait_for

from .conftest import keep_journal
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
        lambda: run.arrangement.control.hold("Follower"),
        lambda: run.arrangement.control.hold("Keeper"),
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


def test_a_clock_that_stood_still_leaves_no_gap_in_a_recording(file: Path) -> None:
    """Events are at the times of the board's messages, and a moment is found by these."""
    machines = {"Keeper": Keeper, "Follower": Follower}
    run = Run(machines.values(), Whiteboard.local(), clock=DebugClock())
    debugger = Debugger.of(run.arrangement)
    debugger.pause()
    thread = threading.Thread(target=run.arrangement.run, kwargs={"grace_s": 0.0})
    with RecordingWriter(file, {"board": "test"}) as writer:
        thread.start()
        for number in range(1, 4):
            debugger.wait(PATIENCE_S)
            paused_ns = time.monotonic_ns()
            wait_for(lambda paused_ns=paused_ns: time.monotonic_ns() > paused_ns + 50_000_000)
            continued_ns = time.monotonic_ns()
            run.board.add_message(COMMAND, Number(number))
            debugger.step()
        debugger.wait(PATIENCE_S)
        run.arrangement.stop()
        thread.join()
        keep_journal(writer, run.entries)
    assert run.again(machines.values())[0] is None
    recording = Recording(file)
    (journal,) = recording.journals
    times = [recording.time_of(record) for record in recording.backwards(journal, 1 << 62)][::-1]
    turns = [
        time
        for time, entry in zip(times, recording.entries(journal), strict=True)
        if entry["event"] == "Turn"
    ]
    assert times == sorted(times)
    assert turns[3] > continued_ns, "after three pauses"

    def again() -> Rerun:
        rerun = Rerun(recording.entries(journal))
        rerun.arrange(machines.values())
        return rerun

    with ReverseDebugger(again, machines, recording.span_ns[0]) as reverse:
        reverse.go_past(continued_ns)
        assert reverse.debugger.moment == 4
        assert reverse.now_s == (turns[3] - recording.span_ns[0]) / 1e9


def test_a_state_begins_when_its_transition_fired_though_the_round_was_paused(file: Path) -> None:
    run = Run([Follower, Keeper], Whiteboard.local(), clock=ManualClock(1))
    debugger = Debugger.of(run.arrangement)
    debugger.pause()
    thread = threading.Thread(target=run.arrangement.run, kwargs={"grace_s": 0.0}, daemon=True)
    thread.start()
    run.board.add_message(COMMAND, Number(16))
    debugger.wait(PATIENCE_S)
    debugger.step("transition")
    debugger.wait(PATIENCE_S)
    fired_ns = debugger.now_ns
    run.clock.advance(s=7)
    debugger.step("round")
    debugger.wait(PATIENCE_S)
    run.arrangement.stop()
    thread.join()
    with RecordingWriter(file, {"board": "test"}) as writer:
        keep_journal(writer, run.entries)
    source = RecordedSource(file)
    while source.player.known_ns < source.player.span_ns[1]:
        source.history()
    changes = [each for each in source.history()["Follower"] if each.source]
    assert changes[0].stamp_ns == fired_ns
