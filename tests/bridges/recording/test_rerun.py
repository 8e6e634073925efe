"""Machines that learn what they learnt do what they did."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from llfsm.bridges.recording.rerun import Rerun, rerun
from llfsm.bridges.turtlesim.node import TurtlesimNode
from llfsm.bridges.turtlesim.simulator import Simulator
from llfsm.machines import RosWallTurttleBot
from llfsm.runtime import Machine, ManualClock, Requirement, Timetable, Trace
from llfsm.runtime.engine.events import IdleSleep
from llfsm.runtime.journal import entries as journal
from llfsm.whiteboard import Whiteboard
from llfsm.whiteboard.liveness import born, host_name
from llfsm.whiteboard.messages.llfsm import MachineStatus, status_slot
from thoroughness import examples

from . import machines
from .journalled_run import JumpingClock, Run, keep
from .machines import COMMAND, SEEN, Failing, Follower, Keeper, Number

OURS = (str(Path(journal.__file__).parent), str(Path(machines.__file__)))

MACHINES: list[type[Machine]] = [Keeper, Follower]

ASK = (
    *("suspend", "hold", "resume", "restart", "stop_machine", "stop", "unload"),
    *("abandon", "suspend_all"),
)

steps = st.lists(
    st.one_of(
        st.tuples(st.just("post"), st.integers(0, 40)),
        st.tuples(st.just("seen"), st.integers(0, 40)),
        st.tuples(st.just("wait"), st.integers(0, 40)),
        st.tuples(st.sampled_from(ASK), st.sampled_from(["Follower", "Keeper"])),
        st.tuples(st.just("elsewhere"), st.sampled_from(["low", "high", "gone"])),
    ),
    max_size=60,
)


def status(state: str) -> MachineStatus:
    """Return what a process that lives, as this one, tells of a machine."""
    pid = os.getpid()
    return MachineStatus(
        state=state,
        suspended=state == "high",
        loaded=state != "gone",
        pid=pid,
        born=born(pid),
        host=host_name(),
    )


@given(steps)
@settings(deadline=None, max_examples=examples(40))
def test_whatever_happens_it_happens_again(script: list[tuple[str, Any]]) -> None:
    run = Run(MACHINES, clock=JumpingClock())
    for what, value in script:
        if what == "post":
            run.board.add_message(COMMAND, Number(value))
        elif what == "seen":  # by another process, which makes the count another one
            run.board.add_message(SEEN, Number(value))
        elif what == "wait":
            run.clock.advance(ms=value)
        elif what == "elsewhere":
            run.board.add_message(status_slot("Elsewhere"), status(value))
        elif what == "stop":
            run.arrangement.stop()
        elif what == "suspend_all":
            run.arrangement.control.suspend_all()
        elif value in [machine.name for machine in run.arrangement.machines]:
            getattr(run.arrangement.control, what)(value)
        run.arrangement.round()
    run.arrangement.end()
    difference, trace = run.again(MACHINES)
    assert difference is None
    assert list(map(repr, trace)) == list(map(repr, run.trace))


def test_a_run_in_real_time_with_idle_sleeps_happens_again() -> None:
    run = Run(MACHINES, idle_us=300)

    def feed(_: object) -> None:
        run.board.add_message(COMMAND, Number(run.arrangement.rounds // 3))
        if run.arrangement.rounds == 150:
            run.arrangement.stop()

    run.arrangement.attach(feed)
    run.arrangement.run(grace_s=0.1)
    difference, trace = run.again(MACHINES)
    assert difference is None
    assert list(map(repr, trace)) == list(map(repr, run.trace))


def test_a_run_whose_sleeps_were_ended_by_messages_happens_again() -> None:
    run = Run(MACHINES, idle_us=600_000_000)

    def feed(event: object) -> None:
        if isinstance(event, IdleSleep):
            number = run.arrangement.rounds // 3
            if number % 8 == 6:
                number += 1  # else the keeper would ask in each round, and never sleep again
            run.board.add_message(COMMAND, Number(number))
            if run.arrangement.rounds >= 60:
                run.arrangement.stop()

    run.arrangement.attach(feed)
    run.arrangement.run(grace_s=0.1)
    assert sum(event["event"] == "IdleSleep" for event in run.entries) > 20
    difference, trace = run.again(MACHINES)
    assert difference is None
    assert list(map(repr, trace)) == list(map(repr, run.trace))


def test_a_timetable_with_requests_in_its_sleeps_happens_again() -> None:
    table = Timetable.meeting(
        [
            Requirement("Keeper", period_us=2000, deadline_us=500),
            Requirement("Follower", period_us=1000, deadline_us=200, starts_us=(700,)),
        ]
    )
    run = Run(MACHINES, clock=JumpingClock(1_001), timetable=table)
    asks = iter([("hold", "Follower"), ("resume", "Follower"), ("restart", "Keeper")] * 20)

    def feed(event: Any) -> None:
        run.board.add_message(
            COMMAND, Number(8 * run.arrangement.rounds + run.arrangement.rounds % 5)
        )
        if type(event).__name__ == "IdleSleep":
            what, name = next(asks, ("", ""))
            if what:
                getattr(run.arrangement.control, what)(name)

    run.arrangement.attach(feed)
    run.arrangement.run(max_rounds=60)
    assert any(event["event"] == "Asked" for event in run.entries)
    difference, _ = run.again(MACHINES, timetable=table)
    assert difference is None


@pytest.mark.parametrize("on_error", ["stop", "suspend"])
def test_a_failure_happens_again(on_error: str) -> None:
    other = "suspend" if on_error == "stop" else "stop"
    run = Run([Failing, Follower], clock=JumpingClock(), on_error=on_error)
    for value in (1, 2, 22, 23, 33, 34):
        run.board.add_message(COMMAND, Number(value))
        try:
            run.arrangement.round()
        except Exception:
            break
    run.arrangement.end()
    difference, trace = run.again([Failing, Follower], on_error=on_error)
    assert difference is None
    assert len(trace) == len(run.trace)
    difference, _ = run.again([Failing, Follower], on_error=other)
    assert difference is not None


def run_with_stop(at: int) -> tuple[Run, int]:
    """Run a little, with a stop before line number `at`, as of a signal; return the lines, too."""
    run = Run([Follower, Follower], clock=JumpingClock(10_001), idle_us=100)
    run.board.add_message(COMMAND, Number(3))
    lines = 0

    def trace(frame: Any, event: str, _: object) -> Any:
        nonlocal lines
        if not frame.f_code.co_filename.startswith(OURS):
            return None
        if event == "line":
            lines += 1
            if lines == at:
                run.arrangement.stop()
        return trace

    before = sys.gettrace()
    sys.settrace(trace)
    try:
        run.arrangement.run(max_rounds=3)
    finally:
        sys.settrace(before)
    return run, lines


def test_a_stop_at_whatever_moment_happens_again() -> None:
    _, lines = run_with_stop(0)
    assert lines > 500
    for at in range(1, lines, 11):
        run, _ = run_with_stop(at)
        difference, trace = run.again([Follower, Follower])
        assert difference is None, at
        assert repr(trace) == repr(run.trace)


def wall(rounds: int) -> Run:
    board, clock = Whiteboard.local(), ManualClock()
    node = TurtlesimNode(Simulator(), board)
    run = Run([RosWallTurttleBot], board, clock=clock)
    for _ in range(rounds):
        node.step()
        clock.advance(ms=16)
        run.arrangement.round()
    run.arrangement.stop()
    while not run.arrangement.finished:
        run.arrangement.round()
    run.arrangement.end()
    return run


def test_every_event_of_the_wall_demo_happens_again_from_the_file(file: Path) -> None:
    run = wall(3000)
    assert len({e.state for e in run.trace if type(e).__name__ == "Turn"}) == 7
    trace = Trace()
    assert rerun(keep(run, file), [RosWallTurttleBot], observers=[trace]) is None
    assert list(map(repr, trace)) == list(map(repr, run.trace))


def test_a_recording_cut_short_is_compared_up_to_there(file: Path) -> None:
    run = wall(300)
    whole = run.entries
    for length in range(2, 120):
        again = Rerun(whole[:length])
        again.arrange([RosWallTurttleBot])
        assert again.compare() is None
    again.arrange([RosWallTurttleBot])
    assert 0 < again.events < 120
