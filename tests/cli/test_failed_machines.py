"""A machine whose code has raised: its error is shown, and it may be resumed or restarted."""

from __future__ import annotations

import signal
import subprocess
from contextlib import suppress
from pathlib import Path

import pytest

from llfsm.whiteboard import BoardFullError, Slot, Whiteboard
from llfsm.whiteboard.messages.llfsm import Bell, status_slot
from waiting import wait_for

from .conftest import MACHINES, Llfsm, rows, wait_for_line

FRAGILE = """
from pathlib import Path
from llfsm.runtime import Machine, State

class Fragile(Machine):
    A = State()
    B = State()
    A.to(B, after_ms=20)

    @B.on_entry
    def _(self):
        if Path("broken").exists():
            raise ValueError("no plan")

    B.to(B, when=lambda m: Path("later").exists() and 1 / 0)
"""


@pytest.fixture
def failed(llfsm: Llfsm, board: str, tmp_path: Path) -> subprocess.Popen[str]:
    """Start a process with a machine that fails while there is a file, and one that does not."""
    (tmp_path / "fragile.py").write_text(FRAGILE)
    (tmp_path / "broken").touch()
    options = ("--on-error", "suspend", "-q", "-b", board)
    process = llfsm.start("run", "fragile:Fragile", f"{MACHINES}:Stubborn", *options)
    wait_for_line(process, "ValueError: no plan")
    with Whiteboard(board, create=False) as wb:
        slot = wb[status_slot("Fragile")]
        wait_for(lambda: slot.count and slot.get().failed, "it is published as failed")
    return process


def test_ps_shows_a_failed_machine_with_its_error(
    llfsm: Llfsm, board: str, tmp_path: Path, failed: subprocess.Popen[str]
) -> None:
    error = f"machine Fragile, state B, OnEntry: ValueError: no plan ({tmp_path / 'fragile.py'}:13)"
    _, *lines = llfsm.run("ps", "-b", board).stdout.splitlines()
    assert [line.split()[:3] for line in lines[:2]] == [
        ["Fragile", "Suspended", "failed"],
        ["Stubborn", "A", "running"],
    ]
    assert lines[2:] == [f"Fragile failed: {error}"]
    why = llfsm.run("why", "Fragile", "-b", board).stdout
    assert why == f"it is in Suspended\nit has failed: {error}\n"
    first = rows(llfsm, "-b", board)
    assert (first["Fragile"]["status"], first["Fragile"]["error"]) == ("failed", error)
    assert first["Fragile"]["error_state"] == "B"
    stubborn = first["Stubborn"]
    assert (stubborn["error"], stubborn["error_state"], stubborn["error_s"]) == ("", "", None)
    second = rows(llfsm, "-b", board)
    assert 0 <= first["Fragile"]["error_s"] < second["Fragile"]["error_s"]
    shown = llfsm.run("top", "--once", "-b", board).stdout.splitlines()
    at = next(number for number, line in enumerate(shown) if line.startswith("Fragile"))
    assert "failed" in shown[at]
    assert shown[at + 1].strip() == error


@pytest.mark.parametrize(("action", "again"), [("resume", "running"), ("restart", "running again")])
def test_a_failed_machine_goes_on_and_what_had_happened_is_printed(
    llfsm: Llfsm,
    board: str,
    tmp_path: Path,
    failed: subprocess.Popen[str],
    action: str,
    again: str,
) -> None:
    (tmp_path / "broken").unlink()
    done = llfsm.run(action, "Fragile", "-b", board)
    assert (done.returncode, done.stderr) == (0, "")
    first, second = done.stdout.splitlines()
    assert first.startswith("Fragile had failed: machine Fragile, state B, OnEntry: ValueError: no")
    assert second.startswith(f"Fragile is {again} in ")
    row = rows(llfsm, "-b", board)["Fragile"]
    assert (row["status"], row["error"], row["error_s"]) == ("running", "", None)
    assert "failed" not in llfsm.run("ps", "-b", board).stdout


@pytest.mark.parametrize("action", ["resume", "restart"])
def test_a_machine_that_fails_again_at_once_is_an_error_of_the_request(
    llfsm: Llfsm, board: str, tmp_path: Path, failed: subprocess.Popen[str], action: str
) -> None:
    """A restarted one has a few turns before it fails: it is reported as running or as failed."""
    done = llfsm.run(action, "Fragile", "-b", board)
    assert "did not carry out" not in done.stderr, "it waited for its patience to end"
    if action == "resume":
        assert done.returncode == 1
        assert done.stdout.startswith("Fragile had failed: machine Fragile, state B, ")
        assert done.stderr.startswith("Error: Fragile has failed again: machine Fragile, state B, ")
        assert "ValueError: no plan" in done.stderr
    with Whiteboard(board, create=False) as wb:
        slot = wb[status_slot("Fragile")]

        def failed_again() -> bool:
            status = slot.get()
            return status.obeyed > 0 and not status.pending and status.failed

        wait_for(failed_again, "it has failed again")
    row = rows(llfsm, "-b", board)["Fragile"]
    assert row["status"] == "failed"
    wait_for_line(failed, "ValueError: no plan")  # each failure is logged


def test_another_failure_replaces_the_first(
    llfsm: Llfsm, board: str, tmp_path: Path, failed: subprocess.Popen[str]
) -> None:
    (tmp_path / "broken").unlink()
    (tmp_path / "later").touch()
    done = llfsm.run("resume", "Fragile", "-b", board)
    with Whiteboard(board, create=False) as wb:
        slot = wb[status_slot("Fragile")]
        wait_for(lambda: "ZeroDivisionError" in slot.get().error, "the guard has failed")
    assert done.returncode == int("has failed again" in done.stderr)
    (tmp_path / "later").unlink()
    done = llfsm.run("resume", "Fragile", "-b", board)
    assert done.returncode == 0
    assert "ZeroDivisionError: division by zero" in done.stdout.splitlines()[0]
    assert "ValueError" not in done.stdout


# With no other machine


@pytest.fixture
def lone(llfsm: Llfsm, board: str, tmp_path: Path) -> subprocess.Popen[str]:
    """Start a process whose only machine fails while there is a file."""
    (tmp_path / "fragile.py").write_text(FRAGILE)
    (tmp_path / "broken").touch()
    process = llfsm.start("run", "fragile:Fragile", "--on-error", "suspend", "-q", "-b", board)
    wait_for_line(process, "ValueError: no plan")
    return process


def test_a_lone_machine_that_failed_is_waited_for(
    llfsm: Llfsm, board: str, tmp_path: Path, lone: subprocess.Popen[str]
) -> None:
    wait_for(lambda: rows(llfsm, "-b", board)["Fragile"]["status"] == "failed", "ps shows it")
    (tmp_path / "broken").unlink()
    done = llfsm.run("restart", "Fragile", "-b", board)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.splitlines()[1].startswith("Fragile is running again in ")
    lone.send_signal(signal.SIGINT)
    assert lone.wait() == 0


def test_ctrl_c_ends_a_run_that_waits_for_a_failed_machine(
    llfsm: Llfsm, board: str, lone: subprocess.Popen[str]
) -> None:
    wait_for(lambda: rows(llfsm, "-b", board)["Fragile"]["status"] == "failed", "ps shows it")
    lone.send_signal(signal.SIGINT)
    assert lone.wait() == 0


def test_a_run_ends_if_nobody_can_reach_its_failed_machine(
    llfsm: Llfsm, board: str, tmp_path: Path
) -> None:
    (tmp_path / "fragile.py").write_text(FRAGILE)
    (tmp_path / "broken").touch()
    llfsm.run("run", f"{MACHINES}:Shy", "-q", "-b", board)  # makes what all runs need
    with Whiteboard(board) as wb, suppress(BoardFullError):
        wb[status_slot("Shy")].reserve()  # a name that was given up makes room
        for number in range(4096):
            wb.add_message(Slot(f"s{number}", Bell), Bell())
    done = llfsm.run("run", "fragile:Fragile", "--on-error", "suspend", "-q", "-b", board)
    assert done.returncode == 1
    assert "Fragile cannot be published on the whiteboard" in done.stderr
    assert done.stderr.splitlines()[-1] == (
        "Error: Fragile failed, and no other process can resume it: the run has ended"
    )
