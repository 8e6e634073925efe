"""Processes that belong together: what becomes of all when one ends."""

from __future__ import annotations

import os
import signal

import pytest

from llfsm.cli.demo.parts import Processes
from llfsm.errors import LlfsmError
from waiting import wait_for

from .conftest import alive


def reported(processes: Processes) -> str:
    def check() -> bool:
        processes.check()
        return bool(processes.reports)

    wait_for(check, "a report")
    return processes.reports.popleft()


def run(processes: Processes, board: str) -> int:
    processes.start("machine", "run", "RosPingPong", "--board", board, "--remove-board")
    (status,) = processes.statuses()
    assert status.pid is not None
    wait_for(lambda: processes.statuses()[0].output, "a line")
    return status.pid


def test_one_that_is_killed_is_started_again(board: str) -> None:
    with Processes(restart=True, pause_s=0.0) as processes:
        pid = run(processes, board)
        os.kill(pid, signal.SIGKILL)
        assert reported(processes) == "the machine was killed by SIGKILL; it starts again"
        processes.check()
        (status,) = processes.statuses()
        assert status.pid not in (None, pid)
        assert not processes.reports


def test_it_is_not_started_again_before_a_pause(board: str) -> None:
    with Processes(restart=True, pause_s=float("inf")) as processes:
        os.kill(run(processes, board), signal.SIGKILL)
        reported(processes)
        processes.check()
        assert processes.statuses()[0].pid is None


def test_all_end_with_the_block(board: str) -> None:
    with Processes() as processes:
        pid = run(processes, board)
    assert not alive(pid)


def test_what_fails_soon_after_its_start_ends_all_with_its_words() -> None:
    with Processes(restart=True) as processes:
        processes.start("machine", "run", "Nobody")
        with pytest.raises(LlfsmError, match=r"(?s)the machine ended with 2\n.*'Nobody'"):
            reported(processes)


def test_what_fails_later_is_started_again() -> None:
    with Processes(restart=True, early_s=0.0) as processes:
        processes.start("machine", "run", "Nobody")
        report = reported(processes)
    assert report.startswith("the machine ended with 2; it starts again\n")
    assert "'Nobody'" in report
