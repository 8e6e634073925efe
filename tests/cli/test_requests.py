"""`llfsm ps`, `suspend`, `resume`, `restart` and `stop`: machines of other processes."""

from __future__ import annotations

import json
import os
import re
import signal
import socket
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click
import pytest

from llfsm.cli.ps import listings
from llfsm.cli.requests import carry_out
from llfsm.runtime.presence.remote import SILENT_S, Directory
from llfsm.whiteboard import Whiteboard
from llfsm.whiteboard.messages.llfsm import Action, request_slot, status_slot
from waiting import wait_for

from .conftest import Llfsm, wait_for_line

MODULE = """
from llfsm.runtime import Machine, State

class Stays(Machine):
    A = State()
    B = State()

    @A.on_entry
    def _(self):
        print(self.name, "entered A", flush=True)

    @A.on_suspend
    def _(self):
        print(self.name, "suspended", flush=True)

    @A.on_resume
    def _(self):
        print(self.name, "resumed", flush=True)

    @B.on_entry
    def _(self):
        print(self.name, "ended well", flush=True)

    A.to(B, when=lambda m: m.stopping)

class Stubborn(Machine):
    A = State()
    A.to(A, when=lambda m: False)

class Shy(Machine):
    A = State()

    @A.on_entry
    def _(self):
        self.suspend_self()

    A.to(A, when=lambda m: False)
"""


@pytest.fixture(autouse=True)
def module(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(MODULE)


@pytest.fixture
def running(llfsm: Llfsm, board: str) -> Iterator[subprocess.Popen[str]]:
    """Start a process with Stays and Stubborn, both told of on the board."""
    process = llfsm.start("run", "mine:Stays", "mine:Stubborn", "-q", "-b", board)
    wait_for_line(process, "Stays entered A")
    with Whiteboard(board, create=False) as wb:
        told = wb[status_slot("Stubborn")]
        wait_for(lambda: told.get().ringlets, "its ringlets are told of")
    yield process
    process.send_signal(signal.SIGCONT)


def rows(llfsm: Llfsm, *arguments: str) -> dict[str, dict[str, Any]]:
    """Return what `llfsm ps` tells of each machine."""
    done = llfsm.run("ps", "--json", *arguments)
    assert (done.returncode, done.stderr) == (0, "")
    found = [json.loads(line) for line in done.stdout.splitlines()]
    return {row["machine"]: row for row in found}


# ps


def test_ps_is_a_table(llfsm: Llfsm, board: str, running: subprocess.Popen[str]) -> None:
    done = llfsm.run("ps", "-b", board)
    assert (done.returncode, done.stderr) == (0, "")
    head, *lines = [line.split() for line in done.stdout.splitlines()]
    assert head == ["MACHINE", "STATE", "STATUS", "SINCE", "RINGLETS", "OVERRUNS", "PID"]
    for line, name in zip(lines, ["Stays", "Stubborn"], strict=True):
        assert line[:3] == [name, "A", "running"]
        assert re.fullmatch(r"\d+\.\d s", " ".join(line[3:5]))
        assert int(line[5]) > 0
        assert line[6:] == ["0", str(running.pid)]


def test_ps_is_json_for_programs(llfsm: Llfsm, board: str, running: subprocess.Popen[str]) -> None:
    told = rows(llfsm, "-b", board)
    assert list(told) == ["Stays", "Stubborn"]
    row = told["Stays"]
    assert row["in_state_s"] >= row["silent_s"] >= 0
    assert row["ringlets"] > 0
    assert {
        key: row[key] for key in ("whiteboard", "state", "status", "overruns", "pid", "host")
    } == {
        "whiteboard": board,
        "state": "A",
        "status": "running",
        "overruns": 0,
        "pid": running.pid,
        "host": socket.gethostname(),
    }


def test_ps_of_every_board(llfsm: Llfsm, board: str, running: subprocess.Popen[str]) -> None:
    done = llfsm.run("ps", "-a")
    assert done.returncode == 0
    head, *lines = [line.split() for line in done.stdout.splitlines()]
    assert head[:2] == ["WHITEBOARD", "MACHINE"]
    assert [line[1] for line in lines if line[0] == board] == ["Stays", "Stubborn"]
    told = [json.loads(line) for line in llfsm.run("ps", "-a", "--json").stdout.splitlines()]
    assert [row["machine"] for row in told if row["whiteboard"] == board] == ["Stays", "Stubborn"]


def test_ps_of_every_board_although_one_goes_meanwhile(
    board: str, running: subprocess.Popen[str]
) -> None:
    [found] = listings([f"{board}-not", board])
    assert found.board == board
    assert [machine.name for machine in found.machines] == ["Stays", "Stubborn"]


def test_ps_of_every_board_although_one_cannot_be_read(
    board: str, running: subprocess.Popen[str], capsys: pytest.CaptureFixture[str]
) -> None:
    broken = Path(f"/dev/shm/llfsm.{board}-broken")
    broken.write_bytes(b"no whiteboard")
    try:
        [found] = listings([f"{board}-broken", board])
    finally:
        broken.unlink()
    assert f"whiteboard '{board}-broken': " in capsys.readouterr().err
    assert [machine.name for machine in found.machines] == ["Stays", "Stubborn"]


def test_ps_of_a_board_without_machines(llfsm: Llfsm, board: str) -> None:
    with Whiteboard(board):
        assert rows(llfsm, "-b", board) == {}
        assert len(llfsm.run("ps", "-b", board).stdout.splitlines()) == 1


def test_machines_of_one_name_are_told_apart(
    llfsm: Llfsm, board: str, running: subprocess.Popen[str]
) -> None:
    second = llfsm.start("run", "mine:Stays", "-q", "-b", board)
    wait_for_line(second, "Stays entered A")
    told = {name: row["pid"] for name, row in rows(llfsm, "-b", board).items()}
    assert told == {"Stays": running.pid, "Stays.0": second.pid, "Stubborn": running.pid}
    assert llfsm.run("stop", "Stays.0", "-b", board).returncode == 0
    assert second.wait() == 0
    assert rows(llfsm, "-b", board)["Stays"]["pid"] == running.pid


def test_what_is_over_is_not_listed(
    llfsm: Llfsm, board: str, running: subprocess.Popen[str]
) -> None:
    running.terminate()
    assert running.wait() == 0
    assert rows(llfsm, "-b", board) == {}


def test_a_killed_process_is_gone_within_a_second(
    llfsm: Llfsm, board: str, running: subprocess.Popen[str]
) -> None:
    """Even if nobody has taken note of its death, so that its number is still in use."""
    with Whiteboard(board, create=False) as wb:
        slot = wb[status_slot("Stays")]
        running.kill()
        os.waitid(os.P_PID, running.pid, os.WEXITED | os.WNOWAIT)
        last_ns, now_ns = slot.sample().stamp_ns, 0

        def gone() -> bool:
            nonlocal now_ns
            now_ns = time.monotonic_ns()
            return not Directory(wb).machines()

        while not gone():
            assert now_ns - last_ns < SILENT_S * 1e9
            os.sched_yield()
    assert rows(llfsm, "-b", board) == {}


def test_a_process_that_stands_still_is_silent(
    llfsm: Llfsm, board: str, running: subprocess.Popen[str]
) -> None:
    def statuses() -> set[str]:
        return {row["status"] for row in rows(llfsm, "-b", board).values()}

    assert statuses() == {"running"}
    running.send_signal(signal.SIGSTOP)
    wait_for(lambda: statuses() == {"silent"}, "machines are silent")
    assert rows(llfsm, "-b", board)["Stays"]["silent_s"] > SILENT_S
    running.send_signal(signal.SIGCONT)
    wait_for(lambda: statuses() == {"running"}, "machines run again")


# Commanders of one slot

COMMANDERS = """
from llfsm.runtime import Actuator, Machine, State
from llfsm.whiteboard import Slot
from llfsm.whiteboard.messages.std_msgs import Int32

class Wall(Machine):
    drive = Actuator(Slot("cmd_vel", Int32))
    A = State()
    A.to(A, when=lambda m: False)

class Blind(Wall):
    pass

class Alone(Machine):
    drive = Actuator(Slot("cmd_vel", Int32), exclusive=True)
    A = State()
    A.to(A, when=lambda m: False)
"""


def test_two_commanders_of_a_slot_are_shown(llfsm: Llfsm, board: str, tmp_path: Path) -> None:
    (tmp_path / "commands.py").write_text(COMMANDERS)
    first = llfsm.start("run", "commands:Wall", "mine:Stubborn", "-q", "-b", board)
    with Whiteboard(board) as wb:
        wait_for(lambda: wb[status_slot("Wall")].count, "the first is published")
        assert "commanders" not in llfsm.run("ps", "-b", board).stdout
        second = llfsm.start("run", "commands:Blind", "-q", "-b", board)
        line = f"cmd_vel has two commanders: Wall (pid {first.pid}), Blind (pid {second.pid})\n"
        assert wait_for_line(first, "commanders") == line
        assert wait_for_line(second, "commanders") == line
        wait_for(lambda: wb[status_slot("Blind")].count, "the second is published")
    assert llfsm.run("ps", "-b", board).stdout.endswith(line)
    assert llfsm.run("whiteboard", "list", board).stdout.endswith(line)
    contested = {name: row["contested"] for name, row in rows(llfsm, "-b", board).items()}
    assert contested == {"Wall": ["cmd_vel"], "Blind": ["cmd_vel"], "Stubborn": []}
    second.kill()
    second.wait()
    assert "commanders" not in llfsm.run("ps", "-b", board).stdout
    assert "commanders" not in llfsm.run("whiteboard", "list", board).stdout


def test_a_second_exclusive_commander_does_not_start(
    llfsm: Llfsm, board: str, tmp_path: Path
) -> None:
    (tmp_path / "commands.py").write_text(COMMANDERS)
    first = llfsm.start("run", "commands:Alone", "-q", "-b", board)
    with Whiteboard(board) as wb:
        wait_for(lambda: wb[status_slot("Alone")].count, "the first is published")
    done = llfsm.run("run", "commands:Alone", "-q", "-b", board)
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr == (
        f"Error: Alone posts to 'cmd_vel' exclusively, but Alone (pid {first.pid}, exclusive) "
        f"does, too; end that machine first\n"
    )


# Requests


def test_suspend_and_resume(llfsm: Llfsm, board: str, running: subprocess.Popen[str]) -> None:
    done = llfsm.run("suspend", "Stays", "-b", board)
    assert (done.returncode, done.stdout) == (0, "Stays is suspended in Suspended\n")
    assert "suspended" in wait_for_line(running, "Stays")
    told = rows(llfsm, "-b", board)
    assert (told["Stays"]["status"], told["Stubborn"]["status"]) == ("suspended", "running")
    assert llfsm.run("suspend", "Stays", "-b", board).returncode == 0
    done = llfsm.run("resume", "Stays", "-b", board)
    assert (done.returncode, done.stdout) == (0, "Stays is running in A\n")
    assert "resumed" in wait_for_line(running, "Stays")
    assert llfsm.run("resume", "Stays", "-b", board).returncode == 0
    assert rows(llfsm, "-b", board)["Stays"]["status"] == "running"


def test_restart(llfsm: Llfsm, board: str, running: subprocess.Popen[str]) -> None:
    done = llfsm.run("restart", "Stays", "-b", board)
    assert (done.returncode, done.stdout) == (0, "Stays is running again in A\n")
    assert "entered A" in wait_for_line(running, "Stays")
    assert llfsm.run("suspend", "Stays", "-b", board).returncode == 0
    assert llfsm.run("restart", "Stays", "-b", board).returncode == 0
    assert "suspended" in wait_for_line(running, "Stays")
    assert "entered A" in wait_for_line(running, "Stays")


def test_stop_ends_one_machine(llfsm: Llfsm, board: str, running: subprocess.Popen[str]) -> None:
    done = llfsm.run("stop", "Stays", "-b", board)
    assert (done.returncode, done.stdout) == (0, "Stays has ended\n")
    assert "ended well" in wait_for_line(running, "Stays")
    assert list(rows(llfsm, "-b", board)) == ["Stubborn"]
    done = llfsm.run("stop", "Stubborn", "-b", board)  # it is unloaded, as it does not listen
    assert (done.returncode, done.stdout) == (0, "Stubborn has ended\n")
    assert running.wait() == 0


def test_a_lone_machine_suspended_from_outside_may_be_resumed(llfsm: Llfsm, board: str) -> None:
    process = llfsm.start("run", "mine:Stays", "-q", "-b", board)
    wait_for_line(process, "Stays entered A")
    assert llfsm.run("suspend", "Stays", "-b", board).returncode == 0
    with Whiteboard(board, create=False) as wb:
        slot = wb[status_slot("Stays")]
        count = slot.count
        wait_for(lambda: slot.count > count + 1, "it is still told of")
    assert process.poll() is None
    assert llfsm.run("resume", "Stays", "-b", board).returncode == 0
    assert llfsm.run("stop", "Stays", "-b", board).returncode == 0
    assert process.stdout.read().endswith("resumed\nStays entered A\nStays ended well\n")
    assert process.wait() == 0


def test_a_lone_machine_suspended_from_outside_ends_with_a_signal(llfsm: Llfsm, board: str) -> None:
    process = llfsm.start("run", "mine:Stays", "-q", "-b", board)
    wait_for_line(process, "Stays entered A")
    assert llfsm.run("suspend", "Stays", "-b", board).returncode == 0
    process.terminate()
    assert process.wait() == 0


def test_a_lone_machine_that_suspends_itself_is_not_waited_for(llfsm: Llfsm, board: str) -> None:
    assert llfsm.run("run", "mine:Shy", "-q", "-b", board).returncode == 0


# A machine whose code has raised

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
    process = llfsm.start("run", "fragile:Fragile", "mine:Stubborn", *options)
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
    begin = time.monotonic()
    done = llfsm.run(action, "Fragile", "-b", board)
    assert time.monotonic() - begin < 3, "it waited for its patience to end"
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
    begin = time.monotonic()
    done = llfsm.run(action, "Fragile", "-b", board)
    assert time.monotonic() - begin < 3, "it waited for its patience to end"
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


# What cannot be done


@pytest.mark.parametrize("action", ["suspend", "resume", "restart", "stop"])
def test_there_must_be_such_a_machine_and_board(
    llfsm: Llfsm, board: str, action: str, running: subprocess.Popen[str]
) -> None:
    done = llfsm.run(action, "Nobody", "-b", board)
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr.startswith("Error: no machine 'Nobody'")
    assert "Stays, Stubborn" in done.stderr
    done = llfsm.run(action, "Nobody", "-b", f"{board}-not")
    assert (done.returncode, done.stdout) == (1, "")
    assert f"{board}-not: no such whiteboard" in done.stderr
    assert llfsm.run(action, "-b", board).returncode == 2


def test_ps_needs_a_board(llfsm: Llfsm, board: str) -> None:
    done = llfsm.run("ps", "-b", board)
    assert (done.returncode, done.stdout) == (1, "")
    assert f"{board}: no such whiteboard" in done.stderr


def test_asking_for_nobody_leaves_no_trace(llfsm: Llfsm, board: str) -> None:
    with Whiteboard(board) as wb:
        before = [info.name for info in wb.slots()]
        llfsm.run("stop", "Nobody", "-b", board)
        assert [info.name for info in wb.slots()] == before


def test_a_machine_may_die_meanwhile(
    llfsm: Llfsm, board: str, running: subprocess.Popen[str]
) -> None:
    running.send_signal(signal.SIGSTOP)
    with Whiteboard(board, create=False) as wb:
        asked = {name: wb[request_slot(name)] for name in ("Stays", "Stubborn")}
        suspending = llfsm.start("suspend", "Stays", "-b", board)
        stopping = llfsm.start("stop", "Stubborn", "-b", board)
        wait_for(lambda: all(slot.count for slot in asked.values()), "both are asked for")
    running.kill()
    running.wait()
    assert suspending.stdout.read() == "Error: Stays has ended in the meantime\n"
    assert suspending.wait() == 1
    assert stopping.stdout.read() == "Stubborn has ended\n"  # as it was to
    assert stopping.wait() == 0


def test_no_resume_while_a_restart_is_pending(
    llfsm: Llfsm, board: str, running: subprocess.Popen[str]
) -> None:
    running.send_signal(signal.SIGSTOP)
    with Whiteboard(board, create=False) as wb:
        asked = wb[request_slot("Stays")]
        restarting = llfsm.start("restart", "Stays", "-b", board)
        wait_for(lambda: asked.count, "a restart is asked for")
        done = llfsm.run("resume", "Stays", "-b", board)
        assert done.returncode == 1
        assert "Stays is about to restart" in done.stderr
        running.send_signal(signal.SIGCONT)
    assert restarting.stdout.read() == "Stays is running again in A\n"
    assert restarting.wait() == 0


@pytest.mark.parametrize("action", ["suspend", "resume", "restart", "stop"])
def test_patience_has_an_end(board: str, running: subprocess.Popen[str], action: Action) -> None:
    """Also if the machine is in the requested state already: that may still change."""
    running.send_signal(signal.SIGSTOP)
    error = "Stays did not carry out the request within 0.1 s; it is in A"
    with (
        Whiteboard(board, create=False) as wb,
        pytest.raises(click.ClickException, match=error),
    ):
        carry_out(wb, "Stays", action, patience_s=0.1)


def test_a_request_that_waits_for_the_next_turn_is_not_done_yet(llfsm: Llfsm, board: str) -> None:
    process = llfsm.start("run", "mine:Stays", "--period", "900000000", "-q", "-b", board)
    wait_for_line(process, "Stays entered A")
    with Whiteboard(board, create=False) as wb:
        with pytest.raises(click.ClickException, match="did not carry out the request"):
            carry_out(wb, "Stays", "restart", patience_s=0.5)
        told = wb[status_slot("Stays")]
        wait_for(lambda: told.get().pending == "restart", "the request is told of")
