"""Hosts that are cut off or die while a machine of one drives the robot of another."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

import wheels
from llfsm.whiteboard import Whiteboard
from llfsm.whiteboard.messages.geometry_msgs import Twist
from llfsm.whiteboard.messages.llfsm import status_slot, will_slot
from llfsm.whiteboard.messages.std_msgs import String
from memory_transport import MemoryWorld
from stopping_robot import Robot, memory_bridge, memory_robot, report
from waiting import wait_for
from wheels import CMD_VEL, CUE, LAMP

from .conftest import NAME, Host
from .switch import Switch

PARTITION_S, AFTER_S = 1.5, 0.1
STATUS, WILL = status_slot("Wheels"), will_slot("Wheels")
FAR = 1


class Pair:
    """A robot and its bridge on the host `near`, and the machine that drives it on `far`."""

    def __init__(self, switch: Switch, hosts: list[Host], folder: Path, stack: ExitStack) -> None:
        self.near, self.far, _ = hosts
        config = folder / "daemon.toml"
        config.write_text(f"[guard]\npartition_s = {PARTITION_S}\n")
        self.near.start("--config", str(config))
        self.far.start("--config", str(config), connect=[self.near])
        self.robot, memory = Robot(), MemoryWorld()
        memory_robot(memory, self.robot, stack)
        memory_bridge(self.near.board, memory, stack)
        self.driven: list[Twist] = []
        """What was on the board of `far`."""
        stack.callback(
            self.far.board[CMD_VEL]
            .subscribe(lambda sample: self.driven.append(sample.message))
            .close
        )
        self.machine = stack.enter_context(
            subprocess.Popen(
                [*switch.prefix(FAR), sys.executable, wheels.__file__,
                 str(self.far.directory), NAME],
                stderr=subprocess.PIPE, text=True,
            )
        )  # fmt: skip
        stack.callback(self.machine.kill)
        self.robot.moves_on()
        # A will is executed when all its slots have what is safe: the cut must not come between.
        wait_for(lambda: self.near.board.get_message(LAMP) == String("on"), "the lamp is on")

    def wait_for_stop(self, since_s: float) -> None:
        """Wait until the guard of `near` has stopped the robot: then, and not before."""
        took_s = self.robot.stopped_after(since_s)
        stop, status = self.near.board[CMD_VEL].sample(), self.near.board[STATUS].sample()
        assert stop.writer == self.near.pid
        assert stop.stamp_ns - status.stamp_ns >= PARTITION_S * 1e9
        report("memory  the host is lost", took_s, PARTITION_S + AFTER_S)
        wait_for(lambda: state(self.near.board) == "executed", "the whole will was executed")

    def far_goes_on(self) -> None:
        """See that nothing is posted on the machine's own host, where it lives."""
        drive = self.far.board[CMD_VEL]
        count = drive.count
        wait_for(lambda: drive.count > count + 20, "the machine drives on")
        assert drive.sample().writer == self.machine.pid
        assert state(self.far.board) == "left"
        assert Twist() not in self.driven


def state(board: Whiteboard) -> str:
    return board.get_message(WILL).state


@pytest.fixture
def pair(switch: Switch, hosts: list[Host], tmp_path: Path) -> Iterator[Pair]:
    with ExitStack() as stack:
        yield Pair(switch, hosts, tmp_path, stack)


def test_a_host_that_is_cut_off_is_dead_for_the_other_until_it_is_back(
    pair: Pair, switch: Switch
) -> None:
    for _ in range(2):
        cut_s = time.monotonic()
        switch.cut(FAR)
        pair.wait_for_stop(cut_s)
        pair.far_goes_on()
        switch.join(FAR)
        pair.robot.moves_on()
        wait_for(lambda: state(pair.near.board) == "left", "it has left its will again")
    speeds = [each.speed for each in pair.robot.got if each.speed]
    assert speeds == sorted(set(speeds))  # no board went back
    assert Twist() not in pair.driven
    pair.machine.kill()
    log = pair.machine.stderr.read()
    assert log.count(f"was executed by process {pair.near.pid} of host") == 2


def test_the_machine_s_own_value_stands_again_after_the_cut(pair: Pair, switch: Switch) -> None:
    pair.far.board.add_message(CUE, String("coast"))
    far = pair.far.board[CMD_VEL]
    wait_for(lambda: far.get() == pair.near.board.get_message(CMD_VEL), "all has arrived")
    cut_s = time.monotonic()
    switch.cut(FAR)
    pair.wait_for_stop(cut_s)
    assert far.get() != Twist()
    count, commanded = far.count, far.get()
    switch.join(FAR)
    wait_for(lambda: pair.near.board.get_message(CMD_VEL) == commanded, "it counts here again")
    wait_for(lambda: state(pair.near.board) == "left", "its will counts here again")
    assert (far.count, far.get()) == (count, commanded)  # where the machine is, nobody interfered
    wait_for(lambda: pair.robot.speed == commanded.linear.x, "the robot follows it")


def test_a_host_that_dies_stops_the_robot_and_one_that_lives_goes_on(pair: Pair) -> None:
    since_s = time.monotonic()
    pair.far.send(9)  # before the machine, or its guard would post
    pair.machine.kill()
    pair.wait_for_stop(since_s)


def test_nothing_is_posted_on_the_host_of_a_machine_when_the_robot_s_dies(pair: Pair) -> None:
    pair.near.send(9)
    assert pair.near.process is not None
    pair.near.process.wait()
    silent = pair.far.board[STATUS]
    count = silent.count
    wait_for(lambda: silent.count > count + 4 * PARTITION_S, "more than the limit passes")
    pair.far_goes_on()
