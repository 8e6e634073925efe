"""What the robot does when something between it and the machine is lost: real processes, killed."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, suppress
from pathlib import Path

import pytest

import wheels
from free_ports import free_endpoint
from llfsm.runtime.presence.guard import Guard, GuardThread
from llfsm.whiteboard import BoardFullError, Slot, Whiteboard
from llfsm.whiteboard.board_files import remove_board
from llfsm.whiteboard.messages.geometry_msgs import Twist, Vector3
from llfsm.whiteboard.messages.std_msgs import Int32
from memory_transport import MemoryWorld
from small_disks import small_disk
from stopping_robot import Robot, memory_bridge, memory_robot, report
from waiting import PATIENCE_S, wait_for
from wheels import CMD_VEL

from .conftest import LLFSM, Processes, Rig, bridge_process, zenoh_robot

KILLED_S, GRACE_S = 0.25, 1.0
BACK = Twist(Vector3(-1.0))
MEET_S = 1.0
"""How long a bridge waits before it guards: the robot's nodes have to find it."""


@pytest.fixture
def own_rig(
    new_board: Callable[[str], Whiteboard], processes: Processes, request: pytest.FixtureRequest
) -> Rig:
    """Return a rig without a bridge and without a robot."""
    return Rig("zenoh", new_board(request.node.originalname), Robot(), processes)


def kill(process: subprocess.Popen[str]) -> None:
    process.kill()
    process.wait()


def since(event: Callable[[], object], rig: Rig) -> float:
    """Return how many seconds after the event the robot stopped."""
    begin_s = time.monotonic()
    event()
    return rig.robot.stopped_after(begin_s)


def drives_on(rig: Rig) -> None:
    """Wait until the machine has posted some more commands."""
    drive = rig.board[CMD_VEL]
    count = drive.count
    wait_for(lambda: drive.count > count + 20, "the machine drives on")


def cut_off(rig: Rig, process: subprocess.Popen[str]) -> None:
    """Kill what connects the robot; see that it goes on, and gets nothing that is posted later.

    Its driver's own time limit is all that remains.
    """
    kill(process)
    posted = rig.board.get_message(CMD_VEL).linear.x
    drives_on(rig)
    assert 0 < rig.robot.speed <= posted


def test_a_bridge_that_dies_leaves_the_robot_going_until_there_is_another(
    own_rig: Rig, router: str
) -> None:
    rig = own_rig

    def bridge() -> subprocess.Popen[str]:
        return bridge_process(rig.board, rig.processes, "zenoh", "--router", router)

    first = bridge()
    zenoh_robot(rig.robot, rig.processes, router)
    machine = rig.drive()
    cut_off(rig, first)
    second = bridge()
    rig.robot.moves_on()  # at the next command
    kill(second)
    kill(machine)
    assert rig.robot.speed != 0
    assert rig.will == "left"
    begin_s = time.monotonic()
    third = bridge()
    ready_s = time.monotonic()
    rig.robot.stopped_after(begin_s)
    assert rig.commander == third.pid
    report("zenoh   a bridge has started", rig.robot.stopped_after(ready_s), MEET_S + KILLED_S)


def router_process(processes: Processes, endpoint: str) -> subprocess.Popen[str]:
    process = processes.start(
        [*LLFSM, "router", "--listen", endpoint], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
    )
    assert process.stdout is not None
    assert "listening" in process.stdout.readline()
    return process


def test_nodes_of_one_host_that_have_met_need_no_router(own_rig: Rig) -> None:
    rig, endpoint = own_rig, free_endpoint()
    router = router_process(rig.processes, endpoint)
    bridge = bridge_process(rig.board, rig.processes, "zenoh", "--router", endpoint)
    zenoh_robot(rig.robot, rig.processes, endpoint)
    machine = rig.drive()
    kill(router)
    rig.robot.moves_on()
    took_s = since(machine.kill, rig)
    assert rig.commander == bridge.pid
    report("zenoh   SIGKILL, without a router", took_s, KILLED_S)


def test_a_router_between_them_that_dies_leaves_the_robot_going_until_there_is_another(
    own_rig: Rig,
) -> None:
    """As between two hosts, where nodes are connected by way of their routers."""
    rig, endpoint = own_rig, free_endpoint()
    router = router_process(rig.processes, endpoint)
    behind = os.environ | {"ZENOH_CONFIG_OVERRIDE": 'mode="client"'}
    where = ("--router", endpoint)
    bridge = bridge_process(rig.board, rig.processes, "zenoh", *where, env=behind)
    zenoh_robot(rig.robot, rig.processes, endpoint)
    machine = rig.drive()
    cut_off(rig, router)
    router = router_process(rig.processes, endpoint)
    rig.robot.moves_on()
    kill(router)
    kill(machine)
    wait_for(lambda: rig.will == "executed", "the guard has posted the safe value")
    assert rig.commander == bridge.pid
    router_process(rig.processes, endpoint)
    wait_for(
        lambda: rig.robot.speed == BACK.linear.x,
        "the robot gets the next command",
        between=lambda: rig.board.add_message(CMD_VEL, BACK),
    )
    assert not any(each.speed == 0 for each in rig.robot.got)  # it was lost


@pytest.mark.parametrize("kind", ["memory", "zenoh"])
def test_a_robot_that_is_started_again_gets_the_next_command(
    own_rig: Rig, kind: str, request: pytest.FixtureRequest
) -> None:
    """When ROS dies, so that no node is left, the machine and the bridge go on."""
    rig, memory = own_rig, MemoryWorld()
    with ExitStack() as first, ExitStack() as stack:
        if kind == "memory":
            memory_robot(memory, rig.robot, first)
            memory_bridge(rig.board, memory, stack)
            stack.enter_context(GuardThread(rig.board.name))
        else:
            router = request.getfixturevalue("router")
            rig.bridge = bridge_process(rig.board, rig.processes, kind, "--router", router).pid
            first.callback(kill, zenoh_robot(rig.robot, rig.processes, router))
        machine = rig.drive()
        first.close()
        drives_on(rig)
        rig.robot = Robot()
        if kind == "memory":
            memory_robot(memory, rig.robot, stack)
        else:
            zenoh_robot(rig.robot, rig.processes, router)
        rig.robot.moves_on()
        took_s = since(machine.kill, rig)
        assert rig.commander == rig.bridge
    report(f"{kind:7} SIGKILL, with the second robot", took_s, KILLED_S)


def test_on_a_board_that_is_removed_the_run_and_the_bridge_end_with_a_stop(
    own_rig: Rig, router: str
) -> None:
    rig = own_rig
    bridge = bridge_process(rig.board, rig.processes, "zenoh", "--router", router)
    zenoh_robot(rig.robot, rig.processes, router)
    machine = rig.drive()
    took_s = since(lambda: remove_board(rig.board.name), rig)
    assert rig.commander == machine.pid
    assert machine.wait(PATIENCE_S) == 75  # the board is gone
    assert rig.lamp == "ended"
    assert bridge.wait(PATIENCE_S) == 75
    assert rig.robot.speed == 0
    report("zenoh   the whiteboard is removed", took_s, GRACE_S + 0.5)


def test_another_guard_does_the_work_of_one_that_dies(own_rig: Rig) -> None:
    rig, memory = own_rig, MemoryWorld()
    with ExitStack() as stack:
        memory_robot(memory, rig.robot, stack)
        memory_bridge(rig.board, memory, stack)
        one, other = (guard_process(rig) for _ in range(2))
        machine = rig.drive()
        kill(one)
        took_s = since(machine.kill, rig)
        assert rig.commander == other.pid
    report("memory  SIGKILL, with the second guard", took_s, KILLED_S)


def guard_process(rig: Rig) -> subprocess.Popen[str]:
    command = [*LLFSM, "guard", "-b", rig.board.name]
    process = rig.processes.start(command, stderr=subprocess.PIPE)
    assert process.stderr is not None
    assert "guarding" in process.stderr.readline()
    return process


def full_of_slots(board: Whiteboard) -> None:
    with suppress(BoardFullError):
        for number in range(5000):
            _ = board[Slot(f"fill/{number}", Int32)]
    with pytest.raises(BoardFullError):
        _ = board[Slot("one/more", Int32)]


def full_of_files(board: Whiteboard) -> None:
    with (board.path.parent / "file").open("wb", buffering=0) as file, suppress(OSError):
        while True:
            file.write(bytes(4096))
    with pytest.raises(BoardFullError):
        board.add_message(Slot("one/more", Int32), Int32())


@pytest.fixture(name="small_disk")
def _small_disk(tmp_path: Path) -> Iterator[Path]:
    with small_disk(tmp_path, "2m"):
        yield tmp_path


@pytest.mark.parametrize("fill", [full_of_slots, full_of_files])
def test_a_machine_that_dies_on_a_full_board_is_stopped(
    small_disk: Path, processes: Processes, fill: Callable[[Whiteboard], None]
) -> None:
    memory, robot = MemoryWorld(), Robot()
    with ExitStack() as stack:
        board = stack.enter_context(Whiteboard("full", directory=small_disk))
        rig = Rig("memory", board, robot, processes)
        memory_robot(memory, robot, stack)
        memory_bridge(board, memory, stack)
        guard = stack.enter_context(closing(Guard(board)))
        machine = processes.start([sys.executable, wheels.__file__, str(small_disk), board.name])
        rig.robot.moves_on()
        guard.look()  # as it does twenty times a second
        fill(board)
        drives_on(rig)
        kill(machine)
        guard.wait(0)
        guard.look()
        wait_for(lambda: robot.speed == 0, "the robot stops")
        assert rig.lamp == "failed"
        assert rig.commander == os.getpid()
