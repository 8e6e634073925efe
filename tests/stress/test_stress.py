"""The whiteboard under stress: see processes.py, stress.c and names.c for what must hold.

``LLFSM_STRESS=80`` does eighty times as much, as `make soak` does; ``LLFSM_STRESS_SEED`` repeats a
run that failed.
"""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest

from llfsm.whiteboard import BoardNotFoundError
from llfsm.whiteboard.board_files import remove_board
from waiting import PATIENCE_S

PROCESSES = Path(__file__).with_name("processes.py")
INCLUDE = Path(__file__).parents[2] / "whiteboard/include"
SCALE = float(os.environ.get("LLFSM_STRESS", "1"))
pytestmark = pytest.mark.timeout(240 * max(SCALE, 1))
SEED = os.environ.get("LLFSM_STRESS_SEED") or str(random.randrange(2**32))


@pytest.fixture
def board() -> Iterator[str]:
    """Name a board of the host's shared memory, and see that it is gone afterwards."""
    name = f"stress-{os.getpid()}"
    yield name
    with suppress(BoardNotFoundError):
        remove_board(name)


def run(scenario: str, board: str, amount: int) -> None:
    command = [sys.executable, str(PROCESSES), scenario, board, SEED, str(amount)]
    done = subprocess.Popen(command, start_new_session=True, stdout=-1, stderr=-1, text=True)
    try:
        output, errors = done.communicate()
    finally:
        with suppress(ProcessLookupError):  # where the time limit has passed, all of them run
            os.killpg(done.pid, signal.SIGKILL)
    print(output)
    assert done.returncode == 0, f"LLFSM_STRESS_SEED={SEED}\n{errors}"


@pytest.mark.compiler
def test_a_board_that_is_changed_while_it_is_used_harms_nobody(tmp_path: Path) -> None:
    program = tmp_path / "hostile"
    command = ["cc", "-std=c11", "-O1", "-pthread", f"-I{INCLUDE}", "-o", str(program)]
    subprocess.run([*command, str(PROCESSES.with_name("hostile.c"))], check=True)
    seconds = str(max(2, round(2 * SCALE)))
    done = subprocess.run([program, seconds, SEED], text=True, capture_output=True, check=False)
    print(done.stdout)
    assert done.returncode == 0, done.stderr


@pytest.mark.compiler
def test_many_threads_read_whole_messages_and_are_woken(tmp_path: Path) -> None:
    """It ends early if they do not, or never."""
    program = tmp_path / "stress"
    command = ["cc", "-std=c11", "-O2", "-pthread", f"-I{INCLUDE}", "-o", str(program)]
    subprocess.run([*command, str(PROCESSES.with_name("stress.c"))], check=True)
    seconds = max(2, round(2 * SCALE))
    done = subprocess.run(
        [program, str(seconds)],
        text=True,
        capture_output=True,
        check=False,
        timeout=seconds + PATIENCE_S,
    )
    print(done.stdout)
    assert done.returncode == 0, done.stderr


@pytest.mark.compiler
def test_names_come_and_go_while_processes_are_killed(tmp_path: Path) -> None:
    program = tmp_path / "names"
    command = ["cc", "-std=c11", "-O1", "-pthread", f"-I{INCLUDE}", "-o", str(program)]
    subprocess.run([*command, str(PROCESSES.with_name("names.c"))], check=True)
    done = subprocess.run(
        [program, "processes", str(SCALE), SEED], text=True, capture_output=True, check=False
    )
    print(done.stdout)
    assert done.returncode == 0, done.stderr


def test_many_reads_are_whole_and_in_order(board: str) -> None:
    run("reads", board, int(1_000_000 * SCALE))


def test_stopped_and_killed_writers_hinder_nobody(board: str) -> None:
    run("faults", board, int(12 * SCALE))
