"""Real processes are known to run, or to have ended."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest

from llfsm.whiteboard import Sample, Slot, Whiteboard
from llfsm.whiteboard.liveness import born, lives, writer_lives
from llfsm.whiteboard.messages.std_msgs import Int64
from waiting import wait_for

SLOT = Slot("number", Int64)
WRITER = """
import sys
from llfsm.whiteboard import Slot, Whiteboard
from llfsm.whiteboard.messages.std_msgs import Int64
with Whiteboard("board", directory=sys.argv[1]) as board:
    board.add_message(Slot("number", Int64), Int64(1))
    print("added", flush=True)
    sys.stdin.read()
"""
IDLE = "import sys; sys.stdin.read()"
ODD_NAME = """
import sys
open("/proc/self/comm", "w").write(sys.argv[1])
print("named", flush=True)
sys.stdin.read()
"""


@contextmanager
def running(code: str, *arguments: object) -> Iterator[subprocess.Popen[str]]:
    """Run code in a process of its own until the context ends, or the test ends it."""
    command = [sys.executable, "-c", code, *map(str, arguments)]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        try:
            yield process
        finally:
            process.kill()


@pytest.fixture
def board(tmp_path: Path) -> Iterator[Whiteboard]:
    with Whiteboard("board", directory=tmp_path) as board:
        yield board


def line(process: subprocess.Popen[str]) -> str:
    assert process.stdout is not None
    return process.stdout.readline()


def latest(board: Whiteboard) -> Sample[Int64]:
    sample = board[SLOT].sample()
    assert sample is not None
    return sample


def is_zombie(pid: int) -> bool:
    return ") Z " in Path(f"/proc/{pid}/stat").read_text()


def test_a_process_lives_until_it_ends() -> None:
    with running(IDLE) as process:
        start = born(process.pid)
        assert start >= born(os.getpid()) > 0
        assert lives(process.pid, start)
        process.kill()
        process.wait()
        assert not lives(process.pid, start)
        assert born(process.pid) == 0


def test_a_process_that_nobody_has_waited_for_does_not_live() -> None:
    with running(IDLE) as process:
        start = born(process.pid)
        process.kill()
        wait_for(lambda: is_zombie(process.pid))
        assert not lives(process.pid, start)


def test_another_start_is_another_process() -> None:
    with running(IDLE) as process:
        assert not lives(process.pid, born(process.pid) + 1)
    assert not lives(process.pid, 0)  # as of one that was dead when it was looked up


@pytest.mark.parametrize("name", [") Z 1 (", "a b", "((("])
def test_a_process_may_have_any_name(name: str) -> None:
    with running(ODD_NAME, name) as process:
        start = born(process.pid)
        assert line(process) == "named\n"
        assert Path(f"/proc/{process.pid}/comm").read_text() == f"{name}\n"
        assert born(process.pid) == start > 0


def test_the_writer_of_a_message_lives_until_it_ends(board: Whiteboard, tmp_path: Path) -> None:
    with running(WRITER, tmp_path) as writer:
        assert line(writer) == "added\n"
        sample = latest(board)
        assert sample.writer == writer.pid
        assert writer_lives(sample)
        writer.kill()
        writer.wait()
        assert not writer_lives(sample)


def test_a_process_that_started_after_the_message_has_not_written_it(
    board: Whiteboard, tmp_path: Path
) -> None:
    """As when the system gives the number of a process that ended to another one."""
    with ExitStack() as stack:
        writer = stack.enter_context(running(WRITER, tmp_path))
        assert line(writer) == "added\n"
        sample = latest(board)
        tick_ns = 1_000_000_000 // os.sysconf("SC_CLK_TCK")  # starts are known to a tick
        wait_for(lambda: time.monotonic_ns() > sample.stamp_ns + 2 * tick_ns)
        later = stack.enter_context(running(IDLE))
        assert born(later.pid) > 0
        assert not writer_lives(sample._replace(writer=later.pid))
        assert writer_lives(sample)
