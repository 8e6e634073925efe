"""What a host tells the others of itself, once a second."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from llfsm.runtime import Arrangement, ExecutionError, Machine, State
from llfsm.runtime.presence.hosts import summary_publisher
from llfsm.whiteboard import Board, Slot, Whiteboard
from llfsm.whiteboard.liveness import born, host_name, pid_namespace
from llfsm.whiteboard.messages.llfsm import (
    HostSummary,
    MachineTrouble,
    MirrorStatus,
    Refusal,
    status_slot,
    summary_slot,
)
from llfsm.whiteboard.messages.llfsm import MachineStatus as Status
from llfsm.whiteboard.messages.std_msgs import Bool

ROBOT = MirrorStatus(
    name="robot7", fleet=("robot*",), leave_rate=3.0, enter_rate=2.0, sent_rate=100.0,
    received_rate=50.0, refused=(Refusal("a", 2), Refusal("b", 3)),
)  # fmt: skip


@pytest.fixture
def board(tmp_path: Path) -> Iterator[Board]:
    with Whiteboard("robots", directory=tmp_path) as board:
        yield board


def run(board: Board, name: str, **fields: Any) -> None:
    """Publish the status of a machine of this process."""
    here = {"born": born(os.getpid()), "host": host_name(), "namespace": pid_namespace()}
    board.add_message(status_slot(name), Status(**{"pid": os.getpid(), **here, **fields}))


@pytest.fixture
def summarize(board: Board) -> Callable[..., HostSummary]:
    def summarize(**how: float) -> HostSummary:
        summary_publisher(board, **how)(ROBOT)
        summary = board.get_message(summary_slot())
        assert summary is not None
        return summary

    return summarize


def test_machines_in_trouble_are_named(board: Board, summarize: Callable[..., HostSummary]) -> None:
    run(board, "Wall")
    run(board, "Plan", failed=True, error="no plan " * 100)
    run(board, "Drive", hung=True, error="drive.py:7")
    run(board, "Gone", pid=1 << 30, born=1)
    run(board, "Ended", loaded=False)
    run(board, "robot8/Wall", failed=True)
    summary = summarize()
    assert (summary.machines, summary.troubled) == (4, 3)
    died = MachineTrouble("Gone", "died", f"its process {1 << 30} has not ended it")
    assert summary.troubles == (
        MachineTrouble("Drive", "hung", "drive.py:7"), died,
        MachineTrouble("Plan", "failed", ("no plan " * 100)[:300]),
    )  # fmt: skip
    assert (summary.leave_rate, summary.enter_rate) == (3.0, 2.0)
    assert (summary.sent_rate, summary.received_rate, summary.refused) == (100.0, 50.0, 5)
    assert status_slot("robot8/Wall").name not in board.read_slots(), "nor is it received for this"

    run(board, "Plan")
    summary = summarize(died_s=0)
    assert (summary.machines, summary.troubled) == (3, 1)


def test_of_many_the_first_are_named(board: Board, summarize: Callable[..., HostSummary]) -> None:
    for number in range(40):
        run(board, f"Plan{number}", failed=True)
    summary = summarize()
    assert (summary.troubled, len(summary.troubles)) == (40, 16)


def test_what_is_no_status_is_left_out(board: Board, summarize: Callable[..., HostSummary]) -> None:
    run(board, "Wall")
    board.add_message(Slot(status_slot("Odd").name, Bool), Bool(True))
    assert summarize().machines == 1


def test_a_host_without_a_name_has_none(board: Board) -> None:
    summary_publisher(board)(MirrorStatus())
    assert board.get_message(summary_slot()) is None


class Doomed(Machine):
    only = State()

    @only.on_entry
    def _(self) -> None:
        raise ValueError("no power")


def test_a_machine_whose_failure_has_ended_the_run_is_named(
    board: Board, summarize: Callable[..., HostSummary]
) -> None:
    arrangement = Arrangement([Doomed()], whiteboard=board)
    with pytest.raises(ExecutionError):
        arrangement.run()
    (trouble,) = summarize().troubles
    assert (trouble.machine, trouble.condition) == ("Doomed", "failed")
    assert "no power" in trouble.error
    assert summarize(died_s=0).troubles == ()
    run(board, "Doomed")
    assert summarize().troubles == ()
