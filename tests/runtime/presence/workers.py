"""Machines in processes of their own, on one whiteboard."""

from __future__ import annotations

import subprocess
import sys

from llfsm.runtime.presence.remote import Directory
from llfsm.whiteboard import Whiteboard
from waiting import wait_for

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
