"""A machine that drives, and a program that runs it or writes what it reads, to be killed by tests.

`driving.py DIRECTORY BOARD ONCE WILL_AFTER_MS` runs the machine, and executes another program when
SIGUSR1 arrives; `driving.py DIRECTORY BOARD` posts
the numbers on its standard input and prints a line after each.
"""

from __future__ import annotations

import logging
import os
import signal
import subprocess
import sys

from forked import Forked
from llfsm.runtime import Actuator, Arrangement, LiveEnvironment, Machine, State
from llfsm.whiteboard import Slot, Whiteboard
from llfsm.whiteboard.messages.std_msgs import Int32, String
from waiting import wait_for

__all__ = ["DRIVE", "GO", "LAMP", "OFF", "QUIET", "SAFE", "Drives", "Runs", "kill"]

DRIVE, LAMP, QUIET = Slot("drive", Int32), Slot("lamp", String), Slot("quiet", Int32)
GO, SAFE, OFF = Int32(data=1), Int32(data=0), String(data="off")


class Drives(Machine):
    """Drive at every turn, until told to end."""

    drive = Actuator(DRIVE, at_failure=SAFE)
    lamp = Actuator(LAMP, at_end=OFF)
    quiet = Actuator(QUIET, at_end=SAFE)  # to which it never posts
    unsafe = Actuator(Slot("unsafe", Int32))
    once: bool = False

    start = State()
    going = State()
    start.to(going)

    @start.on_entry
    def _(self) -> None:
        self.lamp(String(data="on"))
        self.unsafe(GO)
        if self.once:
            self.drive(GO)

    @going.internal
    def _(self) -> None:
        if not self.once:
            self.drive(GO)

    going.to(start, when=lambda m: False)


class Runs:
    """Processes that each run one arrangement on the board."""

    def __init__(self, board: Whiteboard) -> None:
        self._board = board
        self._started: list[subprocess.Popen[str]] = []

    def start(
        self, *, once: bool = False, will_after_ms: int | None = None
    ) -> subprocess.Popen[str]:
        """Start a process with the machine, and wait until it drives."""
        process = Forked(
            [
                sys.executable,
                __file__,
                str(self._board.path.parent),
                self._board.name,
                str(int(once)),
                str(will_after_ms or 0),
            ],
            text=True,
            stderr=subprocess.PIPE,
        )
        self._started.append(process)
        wait_for(lambda: _writer(self._board) == process.pid, "the machine drives")
        return process

    def end(self) -> None:
        """Kill them."""
        for process in self._started:
            process.kill()
            process.wait()
            process.stderr.close()


def kill(process: subprocess.Popen[str]) -> None:
    """Kill a process as nothing else is killed, and wait until it is dead."""
    process.kill()
    process.wait()


def _writer(board: Whiteboard) -> int:
    sample = board[DRIVE].sample()
    return 0 if sample is None else sample.writer


def write(board: Whiteboard) -> None:
    for line in sys.stdin:
        board.add_message(DRIVE, Int32(data=int(line)))
        print(flush=True)


def drive(board: Whiteboard, once: str, will_after_ms: str) -> None:
    logging.basicConfig(level=logging.WARNING)
    signal.signal(signal.SIGUSR1, lambda *_: os.execvp("sleep", ["sleep", "600"]))
    live = LiveEnvironment(board, will_after_ms=int(will_after_ms) or None)
    Arrangement([Drives(once=once == "1")], environment=live).run(grace_s=0.01)


if __name__ == "__main__":
    directory, name, *how = sys.argv[1:]
    with Whiteboard(name, directory=directory) as shared:
        drive(shared, *how) if how else write(shared)
