"""The system's clock is set, by hand or by NTP, while a machine drives."""

from __future__ import annotations

import os
import shlex
import struct
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from llfsm.whiteboard import Whiteboard
from llfsm.whiteboard.messages.llfsm import status_slot
from stopping_robot import Robot, report
from waiting import wait_for
from wheels import CMD_VEL

from .conftest import Processes, Rig, bridge_process, zenoh_robot

HOUR_S = 3600
SOURCE = Path(__file__).with_name("clock.c")
COMPILER = shlex.split(os.environ.get("CC", "cc"))


class SettableClock:
    """Processes in this environment see a clock that can be set."""

    def __init__(self, folder: Path) -> None:
        self._file = folder / "offset"
        library = folder / "clock.so"
        flags = ["-std=c11", "-Wall", "-Wextra", "-Werror", "-shared", "-fPIC"]
        subprocess.run([*COMPILER, *flags, str(SOURCE), "-o", str(library)], check=True)
        self.environment = {"LD_PRELOAD": str(library), "CLOCK_OFFSET": str(self._file)}
        self._file.write_bytes(struct.pack("l", 0))

    def set(self, seconds: int) -> None:
        """Set it so many seconds after the true time; in place, as the file is mapped."""
        with self._file.open("r+b") as file:
            file.write(struct.pack("l", seconds))


@pytest.fixture
def clock(tmp_path: Path) -> SettableClock:
    return SettableClock(tmp_path)


def test_the_clock_of_a_process_is_set(clock: SettableClock) -> None:
    """The harness works: the time of day is another one, and the monotonic clock is not."""
    clock.set(HOUR_S)
    code = "import time; print(time.time(), time.monotonic())"
    before = time.time(), time.monotonic()
    environment = os.environ | clock.environment
    done = subprocess.run([sys.executable, "-c", code], env=environment, stdout=-1, check=True)
    wall, monotonic = map(float, done.stdout.split())
    assert before[0] + HOUR_S <= wall <= time.time() + HOUR_S
    assert before[1] <= monotonic <= time.monotonic()


def lives_on(rig: Rig) -> None:
    """Wait until the machine has posted some more commands and statuses."""
    drive, status = rig.board[CMD_VEL], rig.board[status_slot("Wheels")]
    count, beats = drive.count, status.count
    wait_for(lambda: drive.count > count + 20, "it drives on")
    wait_for(lambda: status.count > beats + 3, "its statuses are published")


def test_a_clock_that_is_set_stops_nothing_and_keeps_nothing_from_stopping(
    clock: SettableClock,
    new_board: Callable[[str], Whiteboard],
    processes: Processes,
    router: str,
) -> None:
    rig = Rig("zenoh", new_board("clock"), Robot(), processes)
    environment = os.environ | clock.environment
    where = ("--router", router)
    bridge = bridge_process(rig.board, processes, "zenoh", *where, env=environment)
    zenoh_robot(rig.robot, processes, router)
    machine = rig.drive("--watchdog", "5000", "--will-after", "1500", env=clock.environment)
    for offset_s in (-24 * HOUR_S, 0, 24 * HOUR_S):
        clock.set(offset_s)
        lives_on(rig)
        assert rig.will == "left"
        assert rig.lamp == "on"
    assert all(each.speed for each in rig.robot.got)
    since_s = time.monotonic()
    clock.set(-24 * HOUR_S)
    machine.kill()
    took_s = rig.robot.stopped_after(since_s)
    assert rig.commander == bridge.pid
    report("zenoh   SIGKILL, after the clock was set", took_s, 0.25)
