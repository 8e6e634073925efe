"""Processes that belong together: what becomes of all when one ends."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator

import pytest

from llfsm.cli.demo import processes as module
from llfsm.cli.demo.processes import ProcessDiedError, Processes
from waiting import wait_for

from .conftest import alive


@pytest.fixture
def processes() -> Iterator[Processes]:
    with Processes(restart=True) as processes:
        yield processes


def reported(processes: Processes) -> str:
    def check() -> bool:
        processes.check()
        return bool(processes.reports)

    wait_for(check, "a report")
    return processes.reports.popleft()


def run(processes: Processes, board: str) -> int:
    processes.start("machine", "run", "RosPingPong", "--board", board, "--remove-board")
    (standing,) = processes.standings()
    assert standing.pid is not None
    wait_for(lambda: processes.standings()[0].said, "a line")
    return standing.pid


def test_one_that_is_killed_is_started_again_after_a_pause(
    processes: Processes, board: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    pid = run(processes, board)
    monkeypatch.setattr(module, "_PAUSE_S", float("inf"))
    os.kill(pid, signal.SIGKILL)
    assert reported(processes) == "the machine was killed by SIGKILL; it starts again"
    processes.check()
    assert processes.standings()[0].pid is None
    monkeypatch.setattr(module, "_PAUSE_S", 0.0)
    processes.check()
    (standing,) = processes.standings()
    assert standing.pid not in (None, pid)
    assert not processes.reports


def test_all_end_with_the_block(board: str) -> None:
    with Processes() as processes:
        pid = run(processes, board)
    assert not alive(pid)


def test_what_fails_soon_after_its_start_ends_all_with_its_words(processes: Processes) -> None:
    processes.start("machine", "run", "Nobody")
    with pytest.raises(ProcessDiedError, match=r"(?s)the machine ended with 2\n.*'Nobody'"):
        reported(processes)


def test_what_fails_later_is_started_again(
    processes: Processes, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "_EARLY_S", 0.0)
    processes.start("machine", "run", "Nobody")
    report = reported(processes)
    assert report.startswith("the machine ended with 2; it starts again\n")
    assert "'Nobody'" in report
