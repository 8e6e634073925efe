"""Real `llfsm` processes on boards of their own."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from calling import call
from forked import Forked
from llfsm.whiteboard import Whiteboard
from llfsm.whiteboard.messages.llfsm import status_slot
from llfsm.whiteboard.shared import boards
from own_boards import own_board
from waiting import PATIENCE_S, wait_for

MACHINES = Path(__file__).with_name("machines.py")


class Llfsm:
    """Start `llfsm` and remember what was started."""

    def __init__(self, cwd: Path) -> None:
        self.cwd = cwd
        self.started: list[subprocess.Popen[str]] = []

    def run(self, *arguments: str, entered: str = "") -> subprocess.CompletedProcess[str]:
        """Run it in the tests' own process."""
        return call(*arguments, cwd=self.cwd, entered=entered)

    def run_apart(self, *arguments: str, entered: str = "") -> subprocess.CompletedProcess[str]:
        """Run it as a process, for what it does as such: forks, tracebacks, its first imports."""
        return subprocess.run(
            self.command(arguments),
            cwd=self.cwd,
            text=True,
            capture_output=True,
            input=entered,
            timeout=PATIENCE_S,
            check=False,
        )

    def run_forked(self, *arguments: str) -> subprocess.CompletedProcess[str]:
        """Run it as a process that has imported llfsm before, for how it ends."""
        command = self.command(arguments)
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
        with Forked(command, cwd=self.cwd, text=True, **pipes) as process:
            stdout, stderr = process.communicate(timeout=PATIENCE_S)
        return subprocess.CompletedProcess(command, process.returncode, stdout, stderr)

    def start(self, *arguments: str) -> subprocess.Popen[str]:
        process = Forked(
            self.command(arguments),
            cwd=self.cwd,
            text=True,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
        )
        self.started.append(process)
        return process

    def command(self, arguments: tuple[str, ...]) -> list[str]:
        return [sys.executable, "-m", "llfsm.cli", *arguments]

    def end(self) -> None:
        """Kill all, and wait for the end of those that they have started."""
        running = [process.pid for process in self.started if process.poll() is None]
        theirs = [pid for each in running for pid in children(each).values()]
        for process in self.started:
            process.kill()
            process.wait()
            process.stdout.close()
        wait_for(lambda: not any(map(alive, theirs)), f"an end of {theirs}")


@pytest.fixture
def llfsm(tmp_path: Path, board: str) -> Iterator[Llfsm]:
    """Start processes that end before the board is removed: one might make it again."""
    llfsm = Llfsm(tmp_path)
    yield llfsm
    llfsm.end()


@pytest.fixture
def board() -> Iterator[str]:
    with own_board() as name:
        yield name


@pytest.fixture
def running(llfsm: Llfsm, board: str) -> Iterator[subprocess.Popen[str]]:
    """Start a process with Stays and Stubborn, both published on the board."""
    process = llfsm.start("run", f"{MACHINES}:Stays", f"{MACHINES}:Stubborn", "-q", "-b", board)
    wait_for_line(process, "Stays entered A")
    with Whiteboard(board, create=False) as wb:
        status = wb[status_slot("Stubborn")]
        wait_for(lambda: status.get().ringlets, "its ringlets are published")
    yield process
    process.send_signal(signal.SIGCONT)


def rows(llfsm: Llfsm, *arguments: str) -> dict[str, dict[str, Any]]:
    """Return what `llfsm ps` prints of each machine."""
    done = llfsm.run("ps", "--json", *arguments)
    assert (done.returncode, done.stderr) == (0, "")
    found = [json.loads(line) for line in done.stdout.splitlines()]
    return {row["machine"]: row for row in found}


def exists(board: str) -> bool:
    return board in {info.name for info in boards()}


def wait_for_line(process: subprocess.Popen[str], text: str) -> str:
    """Read what the process prints up to a line with `text`."""
    printed = ""
    for line in process.stdout:
        printed += line
        if text in line:
            return line
    raise AssertionError(f"{text!r} was never printed, but:\n{printed}")


def offspring(pid: int) -> list[int]:
    """Return the processes started by `pid`, or forked, that have not ended."""
    found = []
    for path in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            state, parent = (path / "stat").read_text().rpartition(")")[2].split()[:2]
            if int(parent) == pid and state != "Z":
                found.append(int(path.name))
    return found


def children(pid: int) -> dict[str, int]:
    """Return the processes started by `pid`, by the llfsm command that each runs."""
    found = {}
    for each in offspring(pid):
        with suppress(OSError):
            words = Path(f"/proc/{each}/cmdline").read_text().split("\0")
            if "llfsm.cli" in words:  # else it is about to be, or has just ended
                found[words[words.index("llfsm.cli") + 1]] = each
    return found


def alive(pid: int) -> bool:
    return state_of(pid) not in ("", "Z")


def stopped(pid: int) -> bool:
    return state_of(pid) == "T"


def state_of(pid: int) -> str:
    """Return the letter of a process's state, or nothing if there is none."""
    with suppress(OSError):
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    return ""
