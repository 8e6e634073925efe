"""From a checkpoint machines show what they show when they run from the beginning."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from llfsm.bridges.recording.errors import RecordingError
from llfsm.bridges.recording.rerun import Rerun
from llfsm.bridges.recording.reversing import checkpoints, worker
from llfsm.bridges.recording.reversing import client as client_module
from llfsm.bridges.recording.reversing.client import ForkingClient, LocalClient, start_client
from llfsm.bridges.recording.reversing.reverse_debugger import ReverseDebugger
from llfsm.errors import LlfsmError
from llfsm.runtime.engine.machine import Machine
from llfsm.runtime.engine.state import State
from llfsm.whiteboard.liveness import born
from waiting import wait_for

from .journalled_run import JumpingClock, Run
from .machines import COMMAND, Failing, Number
from .test_reverse_debugger import MACHINES, journal, sight

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="processes are forked")


class Shown:
    """What is asked in these tests."""

    def __init__(self, debugger: ReverseDebugger):
        self.debugger = debugger

    def do(self, name: str, *arguments: Any) -> object:
        getattr(self.debugger, name)(*arguments)
        return self.sight()

    def sight(self) -> object:
        why = self.debugger.wait()
        return why, self.debugger.end, self.debugger.debugger.fired, sight(self.debugger)

    def process(self) -> int:
        return os.getpid()

    def variables(self, machine: str) -> dict[str, Any]:
        self.debugger.wait()
        found = self.debugger.arrangement.machine(machine)
        return {name: getattr(found, name) for name in type(found).table.variables}


def opened(kind: Any, run: Run, machines: list[Any] = MACHINES) -> Any:
    named = {each.__name__: each for each in machines}

    def again() -> Rerun:
        rerun = Rerun(run.entries)
        rerun.arrange(machines)
        return rerun

    return kind(again, named, 0, Shown)


def do(client: Any, name: str, *arguments: Any) -> object:
    try:
        return client.ask("do", name, *arguments, then=("sight",))
    except LlfsmError as error:
        return str(error)


@pytest.fixture(scope="module")
def run() -> Run:
    return journal(24)


@pytest.fixture(autouse=True)
def often(monkeypatch: pytest.MonkeyPatch) -> None:
    """Keep a moment every few turns."""
    monkeypatch.setattr(worker, "CHECKPOINT_S", 0.0)


@pytest.fixture
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(checkpoints, "MOST_CHECKPOINTS", 4)


STEPS = st.sampled_from(["turn", "round", "transition", "leave"])
TEXTS = st.lists(
    st.sampled_from(["Follower:high", "Follower:low#3", "@command#2", "Keeper:watch->"]),
    unique=True,
    max_size=2,
)
MOVES = st.one_of(
    st.tuples(st.just("step"), STEPS, st.sampled_from([None, "Keeper", "Follower"])),
    st.tuples(st.just("back"), STEPS, st.sampled_from([None, "Keeper", "Follower"])),
    st.tuples(st.just("goto"), st.floats(-0.1, 0.6)),
    st.just(("proceed",)),
    st.just(("back_to_breakpoint",)),
)


@settings(max_examples=4, deadline=None)
@given(texts=TEXTS, moves=st.lists(MOVES, max_size=6), last=st.lists(MOVES, max_size=3))
def test_any_walk_shows_what_a_run_from_the_beginning_shows(
    run: Run, texts: list[str], moves: list[Any], last: list[Any]
) -> None:
    """With breakpoints that are set at the beginning, and after the whole was seen once."""
    with opened(ForkingClient, run) as forking, opened(LocalClient, run) as plain:
        for move in [
            ("goto", 1e9),
            ("break_at", *texts),
            ("goto", 0.0),
            *moves,
            ("break_at",),
            *last,
        ]:
            assert do(forking, *move) == do(plain, *move), move


def children() -> set[int]:
    """Return the processes that run and of which this one is the parent."""
    found = set()
    for name in filter(str.isdecimal, os.listdir("/proc")):
        with suppress(OSError):  # it has ended
            about = Path("/proc", name, "stat").read_text(errors="replace").rpartition(")")[2]
            state, parent, *_ = about.split()
            if int(parent) == os.getpid() and state != "Z":
                found.add(int(name))
    return found


def origin(client: Any, others: set[int]) -> int:
    """Return the process from which machines run from the beginning; `others` are not its own."""
    known = {client.ask("process"), *(each.process for each in client.checkpoints.all)}
    wait_for(lambda: len(children() - known - others) == 1, "those that were left have ended")
    (process,) = children() - known - others
    return process


def test_few_moments_are_kept_and_none_after_that(run: Run, few: None) -> None:
    others = children()
    with opened(ForkingClient, run) as client:
        do(client, "goto", 1e9)
        do(client, "back", "turn")
        points = [*client.checkpoints.all]
        assert len(points) == 4
        ours = {*(each.process for each in points), client.ask("process"), origin(client, others)}
        assert len(ours) == 6
        processes = [(each, born(each)) for each in ours]
        assert all(since for _, since in processes)
        shown = {each.at.number for each in points}
        assert min(shown) < 16 < max(shown), "the whole way has some"
    assert_ended(processes)


def assert_ended(processes: list[tuple[int, int]]) -> None:
    for process, since in processes:
        assert born(process) != since, "no process is left, nor a zombie"


def test_a_moment_whose_process_was_killed_is_done_without(run: Run) -> None:
    """By an earlier one, or the beginning, and its process is started anew."""
    others = children()
    with opened(ForkingClient, run) as client, opened(LocalClient, run) as plain:
        for each in (client, plain):
            do(each, "goto", 1e9)
        for number in range(3):
            points = [*client.checkpoints.all]
            assert points
            killed = points[-2:] if number == 0 else points
            for point in killed:
                os.kill(point.process, signal.SIGKILL)
            if number == 2:
                os.kill(origin(client, others), signal.SIGKILL)
            for move in (("back", "turn"), ("back", "leave", "Keeper"), ("step", "round")):
                assert do(client, *move) == do(plain, *move)
            assert {*killed} - {*client.checkpoints.all}, "it was found to have ended"


def test_machines_whose_process_has_ended_are_where_they_were(run: Run) -> None:
    with opened(ForkingClient, run) as client:
        do(client, "goto", 0.2)
        there = client.ask("sight")
        os.kill(client.ask("process"), signal.SIGKILL)
        with pytest.raises(RecordingError, match="they are where they were"):
            client.ask("do", "goto", 1e9, then=("sight",))
        assert client.ask("sight")[1:] == there[1:]


class Reader(Machine):
    """Write a file and read another, line by line."""

    lines: str = ""

    READ = State()
    END = State()
    READ.to(END, when=lambda m: m.stopping)

    @READ.on_entry
    def _(self) -> None:
        self._file = FILE.open()
        self._written = FILE.with_suffix(".out").open("w")
        OPENED.extend([self._file, self._written])

    @READ.internal
    def _(self) -> None:
        self.lines = self._file.readline()
        self._written.write(self.lines)
        self._written.flush()


FILE = Path()
OPENED: list[Any] = []


def run_of(machine: type[Machine], rounds: int) -> Run:
    run = Run([machine])
    for _ in range(rounds):
        run.arrangement.round()
    run.arrangement.end()
    return run


def test_files_are_read_on_from_where_they_were(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "lines"
    file.write_text("".join(f"{number:02000}\n" for number in range(40)))
    monkeypatch.setattr(sys.modules[__name__], "FILE", file)
    run = run_of(Reader, 40)
    for each in OPENED:
        each.close()
    with opened(ForkingClient, run, [Reader]) as client:
        do(client, "goto", 1e9)
        assert len(client.checkpoints.all) > 2
        for expected in (39, 38, 37, 20, 19):
            while int(client.ask("variables", "Reader")["lines"]) > expected:
                do(client, "back", "turn")
            assert int(client.ask("variables", "Reader")["lines"]) == expected
        do(client, "step", "turn")
        assert int(client.ask("variables", "Reader")["lines"]) == 20
    written = file.with_suffix(".out").read_text().splitlines()
    assert [int(line) for line in written[:21]] == [*range(21)]


GO_ON = threading.Event()


class Threaded(Machine):
    """Start a thread in its tenth turn."""

    turns: int = 0
    child: int = 0

    RUN = State()
    END = State()
    RUN.to(END, when=lambda m: m.stopping)

    @RUN.internal
    def _(self) -> None:
        self.turns += 1
        if self.turns == 20:
            threading.Thread(target=GO_ON.wait, daemon=True).start()


PIPES: list[int] = []
CHILDREN: list[Any] = []


class Connected(Threaded):
    RUN = State()
    END = State()
    RUN.to(END, when=lambda m: m.stopping)

    @RUN.internal
    def _(self) -> None:
        self.turns += 1
        if self.turns == 20:
            PIPES.extend(os.pipe())


class Parent(Threaded):
    RUN = State()
    END = State()
    RUN.to(END, when=lambda m: m.stopping)

    @RUN.internal
    def _(self) -> None:
        self.turns += 1
        if self.turns == 20:
            CHILDREN.append(subprocess.Popen(["cat"], stdin=subprocess.PIPE))
            self.child = CHILDREN[0].pid


@pytest.mark.parametrize("machine", [Threaded, Connected, Parent])
def test_what_cannot_be_copied_is_not_kept(machine: type[Machine]) -> None:
    """The machines run on from before it, with all that they had."""
    run = run_of(machine, 40)
    GO_ON.set()  # what was recorded is over
    while PIPES:
        os.close(PIPES.pop())
    while CHILDREN:
        CHILDREN.pop().communicate()
    GO_ON.clear()
    with opened(ForkingClient, run, [machine]) as client:
        do(client, "goto", 1e9)
        kept = [each.at.number for each in client.checkpoints.all]
        assert kept
        assert max(kept) <= 21
        children = [client.ask("variables", machine.__name__)["child"]]
        do(client, "back", "turn")
        assert client.ask("variables", machine.__name__)["turns"] == 39
        children.append(client.ask("variables", machine.__name__)["child"])
    for child in filter(None, children):  # those of machines become ours
        os.waitpid(child, 0)


def test_without_forks_machines_run_in_the_same_process(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(client_module.sys, "platform", "win32")
        client = opened(start_client, run)
    assert isinstance(client, LocalClient)
    with client, opened(ForkingClient, run) as forking:
        for move in (("step", "turn"), ("goto", 0.2), ("back", "round")):
            assert do(client, *move) == do(forking, *move)


def test_all_ends_when_whoever_asks_is_killed(run: Run) -> None:
    reads, writes = os.pipe()
    asker = os.fork()
    if not asker:
        try:
            os.setsid()
            client = opened(ForkingClient, run)
            do(client, "goto", 1e9)
            found = children()
            os.write(writes, " ".join(f"{each}:{born(each)}" for each in found).encode())
            signal.pause()
        finally:
            os._exit(1)
    os.close(writes)
    found = [tuple(map(int, each.split(":"))) for each in os.read(reads, 4096).decode().split()]
    assert len(found) > 4, "one for the machines, one for their beginning, and those kept"
    os.kill(asker, signal.SIGKILL)
    os.waitpid(asker, 0)
    os.close(reads)
    for process, since in found:
        wait_for_end(process, since)


def wait_for_end(process: int, since: int) -> None:
    with suppress(ProcessLookupError, FileNotFoundError):
        number = os.pidfd_open(process)
        if born(process) == since:
            import select

            poll = select.poll()
            poll.register(number, select.POLLIN)
            assert poll.poll(60_000), "it has not ended"
        os.close(number)


def test_from_the_end_the_failure_that_ended_all_is_gone_back_to() -> None:
    failed = Run([Failing], clock=JumpingClock())
    with suppress(Exception):
        for value in (1, 2, 3, 4, 5, 6, 7, 8, 11):
            failed.board.add_message(COMMAND, Number(value))
            failed.arrangement.round()
    failed.arrangement.end("failed")
    seen = []
    for kind in (LocalClient, ForkingClient):
        with opened(kind, failed, [Failing]) as client:
            do(client, "break_at", "Failing!")
            end = do(client, "goto", 1e9)
            seen.append((end, do(client, "back_to_breakpoint"), do(client, "back_to_breakpoint")))
    assert repr(seen[0]) == repr(seen[1])  # in which errors are equal
    assert seen[0][1][0].startswith("breakpoint Failing!: machine Failing, state good")
    assert seen[0][2] == "no breakpoint is reached before this moment"
