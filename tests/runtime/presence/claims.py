"""Claims to the slot that machines command, and processes with such machines."""

from __future__ import annotations

import signal
import subprocess
import sys

import commanding
from forked import Forked
from llfsm.whiteboard import Board
from llfsm.whiteboard.messages.llfsm import commanders_slot
from waiting import rest_of

CLAIMS = commanders_slot(commanding.CMD.name)


class Process:
    """A process that loads and runs a machine when it is asked to."""

    def __init__(self, board: str, *command: str):
        """Start it by `command`, if there is one."""
        self.popen = Forked(
            [*command, sys.executable, commanding.__file__, board],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        assert self.line() == "ready"

    def line(self) -> str:
        assert self.popen.stdout is not None
        return self.popen.stdout.readline().rstrip()

    def ask(self, kind: str, name: str) -> None:
        assert self.popen.stdin is not None
        self.popen.stdin.write(f"{kind} {name}\n")
        self.popen.stdin.flush()

    def start(self, kind: str, name: str) -> str:
        self.ask(kind, name)
        return self.line()

    def end(self, how: int = signal.SIGTERM) -> str:
        """End it and return what it has printed since."""
        self.popen.send_signal(how)
        return rest_of(self.popen)


def commanders(board: Board) -> list[str]:
    """Return the machines that are listed, also dead ones."""
    claims = board.get_message(CLAIMS)
    return [] if claims is None else [each.machine for each in claims.commanders]
