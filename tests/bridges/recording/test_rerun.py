"""Machines that learn what they learnt do what they did; what they do differently is found."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from llfsm.bridges.recording.errors import (
    NoEventsError,
    OtherMachinesError,
    RecordingFileError,
    RerunError,
)
from llfsm.bridges.recording.reader import Recording
from llfsm.bridges.recording.rerun import Rerun, assert_reruns, rerun
from llfsm.bridges.recording.writer import RecordingWriter
from llfsm.bridges.turtlesim.node import TurtlesimNode
from llfsm.bridges.turtlesim.simulator import Simulator
from llfsm.machines import RosWallTurttleBot
from llfsm.runtime import (
    Actuator,
    Arrangement,
    Machine,
    ManualClock,
    Requirement,
    Sensor,
    State,
    Timetable,
    Trace,
)
from llfsm.runtime.journal import entries as journal
from llfsm.runtime.journal.entries import Entry, Journal, entries_of
from llfsm.runtime.journal.journalled import JournalledEnvironment
from llfsm.runtime.presence.live import LiveEnvironment
from llfsm.whiteboard import Board, Message, Slot, Whiteboard
from llfsm.whiteboard.liveness import born, host_name
from llfsm.whiteboard.messages.llfsm import MachineStatus, status_slot
from waiting import wait_for

from . import machines
from .conftest import end_of, entries_in, keep_journal, write
from .machines import COMMAND, SEEN, Failing, Follower, Keeper, Number

OURS = (str(Path(journal.__file__).parent), str(Path(machines.__file__)))
MACHINES: list[type[Machine]] = [Keeper, Follower]


class JumpingClock(ManualClock):
    """Time passes at each look, so that the order of looks matters."""

    def __init__(self, step_ns: int = 700_001):
        super().__init__()
        self._step_ns = step_ns

    def now_ns(self) -> int:
        self._now_ns += self._step_ns
        return self._now_ns


class Run:
    """An arrangement whose journal is kept."""

    def __init__(
        self,
        machines: Iterable[Any],
        board: Board | None = None,
        *,
        clock: ManualClock | None = None,
        **options: Any,
    ):
        self.board = board or Whiteboard.local()
        self.written: list[bytes] = []
        self.trace = Trace()
        self.clock = clock
        live = LiveEnvironment(self.board, clock)
        environment = JournalledEnvironment(live, Journal(self.written.append))
        self.arrangement = Arrangement(
            machines, environment=environment, observers=[self.trace], **options
        )

    @property
    def entries(self) -> list[Entry]:
        return [entry for data in self.written for entry in entries_of(data)]

    def again(self, machines: Iterable[Any], **options: Any) -> tuple[Any, Trace]:
        """Return the first difference, and all that happens when they run again."""
        trace = Trace()
        run = Rerun(self.entries)
        run.arrange(machines, observers=[trace], **options)
        return run.compare(), trace


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
@settings(deadline=None, max_examples=150)
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
        elif what in ("stop", "suspend_all"):
            getattr(run.arrangement, what)()
        elif value in [machine.name for machine in run.arrangement.machines]:
            getattr(run.arrangement, what)(value)
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
                getattr(run.arrangement, what)(name)

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


def keep(run: Run, file: Path) -> Path:
    with RecordingWriter(file, {"board": "test"}) as writer:
        keep_journal(writer, run.entries)
    return file


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


# What is different is found, and shown


class Patrol(Machine):
    command = Sensor(COMMAND, default=Number(0))
    post = Actuator(SEEN, at_end=Number(-1))

    wait = State()
    go = State()

    @go.on_entry
    def _(self) -> None:
        self.post(Number(self.command.value))

    wait.to(go, when=lambda m: m.command.value > 5)
    go.to(wait, after_ms=50)


class OtherValue(Patrol):
    @Patrol.go.on_entry
    def _(self) -> None:
        self.post(Number(self.command.value + 1))


class Mute(Patrol):
    @Patrol.go.on_entry
    def _(self) -> None:
        pass


class Chatty(Patrol):
    @Patrol.go.internal
    def _(self) -> None:
        self.post(Number(0))


class AtEnd(Patrol):
    post = Actuator(SEEN, at_end=Number(-2))


class Raising(Patrol):
    @Patrol.go.internal
    def _(self) -> None:
        raise ValueError("new")


class AskingOften(Patrol):
    """As Patrol, but for how often it asks for the time."""

    @Patrol.wait.internal
    def _(self) -> None:
        for _ in range(5):
            self.after_ms(3)


def patrol() -> Run:
    run = Run([Patrol], clock=JumpingClock())
    for value in (0, 3, 6, 9, 12, 3, 3, 3):
        run.board.add_message(COMMAND, Number(value))
        run.clock.advance(ms=20)
        run.arrangement.round()
    run.arrangement.end()
    return run


def named(cls: type[Machine]) -> Callable[[], Machine]:
    return type(cls)("Patrol", (cls,), type(cls).__prepare__("Patrol", (cls,)))  # type: ignore


@pytest.mark.parametrize(
    ("cls", "recorded", "now"),
    [
        (OtherValue, "message=[9]", "message=[10]"),
        (Mute, "Posted(machine='Patrol', actuator='post', slot='seen', message=[9]", "Eval("),
        (Chatty, "RoundEnd(", "Posted(machine='Patrol', actuator='post', slot='seen', message=[0]"),
        (AtEnd, "message=[-1]", "message=[-2]"),
        (Raising, "RoundEnd(", "Posted("),
    ],
)
def test_the_first_difference_is_shown(cls: type[Machine], recorded: str, now: str) -> None:
    difference, _ = patrol().again([named(cls)])
    assert difference is not None
    head, before, after = str(difference).splitlines()
    assert head.startswith(f"event {difference.number} differs, ")
    assert before.startswith("  recorded: ")
    assert recorded in before
    assert after.startswith("  now:      ")
    assert now in after


def test_how_often_the_time_is_asked_for_is_no_difference() -> None:
    difference, _ = patrol().again([named(AskingOften)])
    assert difference is None


def test_pytest_shows_it(file: Path) -> None:
    keep(patrol(), file)
    assert_reruns(file, [Patrol])
    with pytest.raises(RerunError, match=r"event \d+ differs.*\n.*\n.*message=\[10\]"):
        assert_reruns(str(file), [named(OtherValue)])


def test_other_machines_are_refused(file: Path) -> None:
    keep(patrol(), file)
    for wrong in ([], [Follower], [Patrol, Follower]):
        with pytest.raises(OtherMachinesError, match=f"{file}: its machines are Patrol, not "):
            rerun(file, wrong)


def test_a_recording_without_events_says_how_to_make_one(file: Path) -> None:
    write(file, [])
    with pytest.raises(NoEventsError, match="llfsm run --record"):
        rerun(file, [Patrol])


class Text(Message):
    value: str


def test_messages_that_are_no_longer_of_the_sensors_type_are_told(file: Path) -> None:
    class Changed(Patrol):
        command = Sensor(Slot("command", Text), default=Text("6"))

    keep(patrol(), file)
    with pytest.raises(RecordingFileError, match="Patrol cannot read what its sensor 'command'"):
        rerun(file, [named(Changed)])


POSTED = {"machine": "m", "actuator": "a", "slot": "s", "count": 1}


@pytest.mark.parametrize(
    "entry",
    [
        {"event": "Posted", **POSTED, "message": "?"},
        {"event": "Posted", **POSTED},
        {"event": "Dreamt", **POSTED},
    ],
)
def test_an_event_that_is_none_is_told(file: Path, entry: Entry) -> None:
    with RecordingWriter(file, {}) as writer:
        keep_journal(writer, [entry])
    with pytest.raises(RecordingFileError, match="has an invalid event"):
        entries_in(Recording(file))


# The command


def turns_in(file: Path) -> int:
    with suppress(FileNotFoundError, RecordingFileError):  # not begun yet
        return sum(entry["event"] == "Turn" for entry in entries_in(Recording(file)))
    return 0


def test_a_demo_that_was_recorded_runs_again(llfsm: Any, board: Whiteboard, file: Path) -> None:
    llfsm("turtlesim", "-b", board.name)
    machine = llfsm("run", "RosWallTurttleBot", "-q", "-b", board.name, "--record", file)
    bound = board[Slot("turtle1/cmd_vel", board_type(board))]
    assert bound.wait(after=0, timeout=30)
    wait_for(lambda: turns_in(file) > 50, "turns in the file")
    machine.terminate()
    assert end_of(machine)[0] == 0
    recording = Recording(file)
    assert recording.complete
    assert {"turtle1/pose", "turtle1/cmd_vel"} <= {*recording.slots}
    status, said = end_of(llfsm("rerun", file))
    assert (status, said.split()[-3:]) == (0, ["are", "as", "recorded"])
    status, said = end_of(llfsm("rerun", file, "RosWallTurttleBot=RosBlindTurttleBot"))
    assert status == 1
    assert said.startswith(f"Error: {file}: event ")
    status, said = end_of(llfsm("rerun", file, "RosBlindTurttleBot"))
    assert (status, said.count("\n")) == (1, 1)
    assert "its machines are RosWallTurttleBot, not RosBlindTurttleBot" in said


def test_llfsm_demo_records_what_runs_again(llfsm: Any, file: Path) -> None:
    name = f"test-demo-{os.getpid()}"
    demo = llfsm("demo", "wall", "-b", name, "--record", file)

    def has_pose() -> bool:
        with suppress(FileNotFoundError, RecordingFileError):  # not begun yet
            return "turtle1/pose" in Recording(file).slots
        return False

    wait_for(has_pose, "a pose")
    demo.send_signal(signal.SIGINT)
    assert end_of(demo)[0] == 0
    assert Recording(file).about["board"] == name
    status, said = end_of(llfsm("rerun", file, "RosWallTurttleBot"))
    assert (status, said.split()[-3:]) == (0, ["are", "as", "recorded"])


def board_type(_: Whiteboard) -> Any:
    from llfsm.whiteboard.messages.geometry_msgs import Twist

    return Twist


@pytest.mark.parametrize(
    ("make", "arguments", "why"),
    [
        (lambda file: write(file, []), [], "holds no events of machines"),
        (lambda file: keep(patrol(), file), [], "has no plan of its machines"),
        (lambda file: file.write_text("?"), [], "is not a recording of llfsm"),
    ],
)
def test_wrong_use_is_one_line(
    llfsm: Any, file: Path, make: Any, arguments: list[str], why: str
) -> None:
    make(file)
    status, said = end_of(llfsm("rerun", file, *arguments))
    assert (status, said.count("\n")) == (1, 1)
    assert why in said
