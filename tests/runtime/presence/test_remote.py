"""Machines of other processes: controlled and asked by name, on a whiteboard in shared memory."""

from __future__ import annotations

import os
import signal
from typing import Any

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
from llfsm.runtime.presence.remote import Directory
from llfsm.whiteboard import BoundSlot, Slot, Whiteboard
from llfsm.whiteboard.liveness import born, host_name, pid_namespace
from llfsm.whiteboard.local import LocalBoard
from llfsm.whiteboard.messages.llfsm import MachineStatus, status_slot
from waiting import PATIENCE_S, wait_for

from .workers import Processes


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
    *answers, last = commander.answers
    assert answers == [Status.RUNNING, Status.SUSPENDED, Status.RUNNING, Status.SUSPENDED]
    assert last in (Status.ERROR, Status.RUNNING)  # which may have been restarted already
    assert commander.states == ["ASLEEP", "WORK", "ASLEEP", "WORK"]
    worker.send_signal(signal.SIGTERM)
    printed, _ = worker.communicate(timeout=PATIENCE_S)
    assert printed.split() == [  # a restart runs no OnResume
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
    wait_for(lambda: arrangement.control.is_running("Worker"), "not running")


def test_a_stop_through_the_board_ends_the_process_of_a_lone_machine(
    board: Whiteboard, processes: Processes
):
    worker = processes.run("Worker")
    Directory(board).find("Worker").request("stop")
    printed, _ = worker.communicate(timeout=PATIENCE_S)
    assert printed.split() == ["WORK", "accepting"]  # after the grace period
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
        arrangement.control.is_running,
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


@pytest.mark.parametrize("ask", ["index_of", "unload", "abandon", "hold", "stop_machine"])
def test_what_is_done_here_only_knows_machines_here_only(board: Whiteboard, ask: str):
    parent = os.getppid()
    status = MachineStatus(
        "a", pid=parent, born=born(parent), host=host_name(), namespace=pid_namespace()
    )
    board.add_message(status_slot("Other"), status)
    arrangement = Arrangement([Asks], whiteboard=board)
    assert arrangement.control.is_running("Other")
    with pytest.raises(UnknownMachineError, match=r"no machine 'Other'; loaded: Asks$"):
        getattr(arrangement.control, ask)("Other")


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

    def publisher(self, slot: Slot[Any], *, make: bool = True) -> BoundSlot[Any]:
        self.bound += 1
        return super().publisher(slot, make=make)


def ask_all(directory: Directory) -> None:
    directory.find("Other").request("suspend")
    directory.machines()


def test_asking_again_binds_no_slot_again():
    board, parent = CountingBoard(), os.getppid()
    status = MachineStatus(
        "a", pid=parent, born=born(parent), host=host_name(), namespace=pid_namespace()
    )
    board.add_message(status_slot("Other"), status)
    directory = Directory(board)
    for _ in range(2):  # the second time, there is a slot for requests
        ask_all(directory)
    before = board.bound
    for _ in range(10):
        ask_all(directory)
    assert board.bound == before


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
