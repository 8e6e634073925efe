"""Machines of other processes: controlled and asked by name, on a whiteboard in shared memory."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any
from uuid import uuid4

import pytest

from llfsm.machines import TurtleSuspendResume
from llfsm.runtime import (
    Arrangement,
    Machine,
    ManualClock,
    Reason,
    State,
    Status,
    UnknownMachineError,
)
from llfsm.runtime.presence.remote import SILENT_S, Directory, is_live
from llfsm.whiteboard import BoardNotFoundError, BoundSlot, Sample, Slot, Whiteboard
from llfsm.whiteboard.board_files import remove_board
from llfsm.whiteboard.liveness import born, host_name
from llfsm.whiteboard.local import LocalBoard
from llfsm.whiteboard.messages.llfsm import MachineStatus, status_slot
from waiting import PATIENCE_S, wait_for

WORKER = """
from llfsm.runtime import *

class Worker(Machine):
    WORK = State()
    NEVER = State()
    ASLEEP = State(suspend=True)
    WORK.to(NEVER, when=lambda m: False)
    WORK.on_entry(lambda m: print("WORK", flush=True))
    WORK.on_suspend(lambda m: print("suspended", flush=True))
    WORK.on_resume(lambda m: print("resumed", flush=True))
    ASLEEP.on_entry(lambda m: print("ASLEEP", flush=True))
"""


class Processes:
    """Start machines in processes of their own, on one board."""

    def __init__(self, board: Whiteboard) -> None:
        self.board = board
        self.started: list[subprocess.Popen[str]] = []

    def run(self, machines: str, code: str = WORKER) -> subprocess.Popen[str]:
        """Run some machines, and return when the board tells of them."""
        known = {machine.name for machine in Directory(self.board).machines()}
        program = (
            f"{code}\n"
            f"from llfsm.runtime import *\n"
            f"from llfsm.whiteboard import Whiteboard\n"
            f"board = Whiteboard({self.board.name!r})\n"
            f"arrangement = Arrangement([{machines}], whiteboard=board, idle_us=1_000)\n"
            f"print(arrangement.run(grace_s=0.05), flush=True)\n"
        )
        process = subprocess.Popen(
            [sys.executable, "-c", program], stdout=subprocess.PIPE, text=True
        )
        self.started.append(process)
        wait_for(
            lambda: {machine.name for machine in Directory(self.board).machines()} - known,
            "no machine",
        )
        return process

    def end(self) -> None:
        for process in self.started:
            process.kill()
            process.wait()
            assert process.stdout is not None
            process.stdout.close()


@pytest.fixture
def board() -> Iterator[Whiteboard]:
    name = f"test-{os.getpid()}-{uuid4().hex[:8]}"
    try:
        with Whiteboard(name) as board:
            yield board
    finally:
        with suppress(BoardNotFoundError):
            remove_board(name)


@pytest.fixture
def processes(board: Whiteboard) -> Iterator[Processes]:
    processes = Processes(board)
    yield processes
    processes.end()


class Commander(Machine):
    """Suspend, resume and restart a machine, each when the one before has taken effect."""

    target: str = "Worker"
    answers: list[Any] = []  # noqa: RUF012
    states: list[str] = []  # noqa: RUF012

    suspending = State()
    resuming = State()
    suspending_again = State()
    restarting = State()
    done = State()

    @suspending.on_entry
    @suspending_again.on_entry
    def _(self) -> None:
        self.answers.append(self.suspend(self.target))

    @resuming.on_entry
    def _(self) -> None:
        self.answers.append(self.resume(self.target))

    @restarting.on_entry
    def _(self) -> None:
        self.answers.append(self.restart(self.target))
        self.answers.append(self.resume(self.target))

    @suspending.on_exit
    @resuming.on_exit
    @suspending_again.on_exit
    @restarting.on_exit
    def _(self) -> None:
        self.states.append(self.state_name_of(self.target))

    def asleep(self) -> bool:
        return self.is_suspended(self.target) and self.status(self.target) == Status.SUSPENDED

    def awake(self) -> bool:
        return self.is_running(self.target)

    suspending.to(resuming, when=asleep)
    resuming.to(suspending_again, when=awake)
    suspending_again.to(restarting, when=asleep)
    restarting.to(done, when=awake)


def test_a_machine_controls_one_of_another_process(board: Whiteboard, processes: Processes):
    worker = processes.run("Worker")
    commander = Commander()
    arrangement = Arrangement([commander], whiteboard=board, idle_us=1_000)
    assert arrangement.run() is Reason.ACCEPTING
    assert commander.answers == [
        Status.RUNNING,
        Status.SUSPENDED,
        Status.RUNNING,
        Status.SUSPENDED,
        Status.ERROR,
    ]
    assert commander.states == ["ASLEEP", "WORK", "ASLEEP", "WORK"]
    worker.send_signal(signal.SIGTERM)
    said, _ = worker.communicate(timeout=PATIENCE_S)
    assert said.split() == [  # a restart runs no OnResume
        *["WORK", "suspended", "ASLEEP", "resumed", "WORK"],
        *["suspended", "ASLEEP", "WORK", "stopped"],
    ]


def test_who_asks_from_outside_reaches_it_too(board: Whiteboard, processes: Processes):
    processes.run("Worker")
    arrangement = Arrangement(whiteboard=board)
    assert arrangement.suspend("Worker") is Status.RUNNING
    wait_for(lambda: arrangement.is_suspended("Worker"), "not suspended")
    assert arrangement.state_name_of("Worker") == "ASLEEP"
    assert arrangement.status("Worker") is Status.SUSPENDED
    assert arrangement.restart("Worker") is Status.SUSPENDED
    wait_for(lambda: arrangement.is_running("Worker"), "not running")


def test_a_stop_through_the_board_ends_the_process_of_a_lone_machine(
    board: Whiteboard, processes: Processes
):
    worker = processes.run("Worker")
    Directory(board).find("Worker").request("stop")
    said, _ = worker.communicate(timeout=PATIENCE_S)
    assert said.split() == ["WORK", "accepting"]  # after the grace period
    assert Directory(board).machines() == []


def test_two_processes_with_one_machine_have_it_under_two_names(
    board: Whiteboard, processes: Processes
):
    processes.run("Worker")
    processes.run("Worker")
    assert sorted(machine.name for machine in Directory(board).machines()) == ["Worker", "Worker.0"]
    Directory(board).find("Worker.0").request("suspend")
    wait_for(lambda: Directory(board).find("Worker.0").suspended, "not suspended")
    assert not Directory(board).find("Worker").suspended


def test_a_machine_here_hides_one_of_that_name_elsewhere(board: Whiteboard, processes: Processes):
    processes.run("Worker")

    class Worker(Machine):
        a = State()
        b = State()
        a.to(b, when=lambda m: False)

    arrangement = Arrangement([Worker], whiteboard=board)
    arrangement.suspend("Worker")
    arrangement.round()
    assert arrangement.state_name_of("Worker") == "Suspended"
    assert Directory(board).find("Worker").state == "WORK"


# Nobody


class Asks(Machine):
    name_asked: str = "Nobody"

    a = State()

    @a.on_entry
    def _(self) -> None:
        self.suspend(self.name_asked)


def test_a_machine_that_nobody_runs_is_unknown_and_others_are_named(
    board: Whiteboard, processes: Processes
):
    processes.run("Worker")
    arrangement = Arrangement([Asks], whiteboard=board)
    for ask in (
        arrangement.suspend,
        arrangement.resume,
        arrangement.restart,
        arrangement.is_suspended,
        arrangement.is_running,
        arrangement.status,
        arrangement.state_name_of,
    ):
        with pytest.raises(
            UnknownMachineError,
            match="no machine 'Nobody'; loaded: Asks; run by other processes: Worker",
        ) as caught:
            ask("Nobody")
        assert caught.value.known == ("Asks",)
        assert caught.value.elsewhere == ("Worker",)


@pytest.mark.parametrize("ask", ["index_of", "unload", "abandon", "machine", "stop_machine"])
def test_what_is_done_here_only_knows_machines_here_only(board: Whiteboard, ask: str):
    parent = os.getppid()
    status = MachineStatus("a", pid=parent, born=born(parent), host=host_name())
    board.add_message(status_slot("Other"), status)
    arrangement = Arrangement([Asks], whiteboard=board)
    assert arrangement.is_running("Other")
    with pytest.raises(UnknownMachineError, match=r"no machine 'Other'; loaded: Asks$"):
        getattr(arrangement, ask)("Other")


def test_without_a_board_only_machines_here_are_known():
    arrangement = Arrangement([Asks])
    with pytest.raises(UnknownMachineError, match=r"no machine 'Nobody'; loaded: Asks$"):
        arrangement.suspend("Nobody")


@pytest.mark.parametrize("name", ["", "x" * 300, "\x00", "\ud800"])
def test_what_can_be_no_name_is_an_unknown_machine(board: Whiteboard, name: str):
    with pytest.raises(UnknownMachineError):
        Arrangement([Asks], whiteboard=board).suspend(name)


def test_asking_for_nobody_leaves_nothing_on_the_board(board: Whiteboard):
    arrangement = Arrangement([Asks], whiteboard=board)
    for number in range(10):
        with pytest.raises(UnknownMachineError):
            arrangement.is_suspended(f"Nobody{number}")
    assert board.slots() == []


class CountingBoard(LocalBoard):
    """Count how often a slot was bound."""

    bound = 0

    def _bind(self, slot: Slot[Any]) -> BoundSlot[Any]:
        self.bound += 1
        return super()._bind(slot)


def ask_all(directory: Directory) -> None:
    directory.find("Other").request("suspend")
    directory.machines()


def test_asking_again_binds_no_slot_again():
    board, parent = CountingBoard(), os.getppid()
    status = MachineStatus("a", pid=parent, born=born(parent), host=host_name())
    board.add_message(status_slot("Other"), status)
    directory = Directory(board)
    ask_all(directory)
    before = board.bound
    for _ in range(10):
        ask_all(directory)
    assert board.bound == before


# Deaths and silence


def test_a_machine_of_a_process_that_was_killed_is_unknown(board: Whiteboard, processes: Processes):
    worker = processes.run("Worker")
    worker.kill()
    worker.wait()
    with pytest.raises(UnknownMachineError, match=r"no machine 'Worker'; on .*: none$"):
        Directory(board).find("Worker")
    assert Directory(board).machines() == []


def test_a_machine_of_a_killed_process_that_nobody_waits_for_is_unknown_within_a_second(
    board: Whiteboard, processes: Processes
):
    worker = processes.run("Worker")
    worker.kill()
    os.waitid(os.P_PID, worker.pid, os.WEXITED | os.WNOWAIT)  # it is dead, and stays a zombie
    until = time.monotonic() + SILENT_S
    wait_for(lambda: time.monotonic() >= until, "time stands still")
    assert Directory(board).machines() == []


def test_its_name_is_free_for_the_next_process(board: Whiteboard, processes: Processes):
    worker = processes.run("Worker")
    worker.kill()
    worker.wait()
    processes.run("Worker")
    assert [machine.name for machine in Directory(board).machines()] == ["Worker"]


def test_a_stopped_process_is_listed_and_its_silence_grows(board: Whiteboard, processes: Processes):
    worker = processes.run("Worker")
    worker.send_signal(signal.SIGSTOP)
    wait_for(lambda: Directory(board).find("Worker").silent_s > SILENT_S + 0.1, "not silent")
    (machine,) = Directory(board).machines()
    assert (machine.name, machine.state, machine.suspended) == ("Worker", "WORK", False)
    assert machine.silent_s > SILENT_S
    assert machine.in_state_s > SILENT_S
    worker.send_signal(signal.SIGCONT)
    wait_for(lambda: Directory(board).find("Worker").silent_s < SILENT_S, "still silent")


ME = {"pid": os.getpid(), "born": born(os.getpid()), "host": host_name()}
NO_PID = 2**22 + 1  # beyond all that Linux gives


@pytest.mark.parametrize(
    ("changes", "recent", "live"),
    [
        ({}, True, True),
        ({}, False, True),  # it stands still
        ({"loaded": False}, True, False),
        ({"born": 1}, False, False),  # its number is another process's now
        ({"pid": NO_PID}, True, False),
        ({"pid": NO_PID}, False, False),
        ({"host": "elsewhere"}, True, True),
        ({"host": "elsewhere"}, False, False),
        ({"host": "elsewhere", "pid": NO_PID}, True, True),
    ],
)
def test_who_is_live(changes: dict[str, Any], recent: bool, live: bool):
    ago_s = SILENT_S * (0.2 if recent else 1.1)
    status = MachineStatus("a", **{**ME, **changes})
    sample = Sample(status, 1, time.monotonic_ns() - round(ago_s * 1e9), ME["pid"])
    assert is_live(sample) is live


def test_a_process_is_told_from_a_later_one_of_its_number():
    assert born(os.getpid()) == born(os.getpid()) > 0
    assert born(NO_PID) == 0
    with subprocess.Popen(
        # A name with what separates fields, as anybody may choose it.
        [
            sys.executable,
            "-c",
            "from pathlib import Path; Path('/proc/self/comm').write_text('a) Z 1 (b'); input()",
        ],
        stdin=subprocess.PIPE,
    ) as process:
        assert process.stdin is not None
        comm = Path(f"/proc/{process.pid}/comm")
        wait_for(lambda: ") Z" in comm.read_text(), "not renamed")
        assert born(process.pid) >= born(os.getpid())
        process.kill()
        os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOWAIT)
        assert born(process.pid) == 0  # a zombie


# The machines that ship


def test_turtle_suspend_resume_controls_the_blind_turtle_of_another_process(
    board: Whiteboard, processes: Processes
):
    processes.run("RosBlindTurttleBot", "from llfsm.machines import RosBlindTurttleBot")
    clock = ManualClock()  # so that its eight seconds take none
    arrangement = Arrangement([TurtleSuspendResume], whiteboard=board, clock=clock)
    turtle = "RosBlindTurttleBot"

    def reach(state: str) -> None:
        def there() -> bool:
            arrangement.round()
            return arrangement.state_name_of("TurtleSuspendResume") == state

        wait_for(there, f"never in {state}")
        arrangement.round()  # enters it: its clock starts

    for _ in range(2):
        reach("HOLD")
        assert Directory(board).find(turtle).suspended
        clock.advance(ms=3_001)
        reach("WATCH")
        assert not Directory(board).find(turtle).suspended
        clock.advance(ms=5_001)
    assert Directory(board).find(turtle).state in ("INITIAL", "STRAIGHT", "TURN_RIGHT")
    arrangement.stop()
    while not arrangement.finished:
        arrangement.round()
    assert arrangement.machines == ()
