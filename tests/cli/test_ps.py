"""`llfsm ps`: machines of all processes, and slots that several of them command."""

from __future__ import annotations

import json
import os
import re
import signal
import socket
import subprocess
import time
from pathlib import Path

import pytest
from msgspec.structs import replace

import commanding
from llfsm.cli.options import BoardPlace
from llfsm.cli.ps import listings
from llfsm.runtime.presence.remote import SILENT_S, Directory
from llfsm.whiteboard import Whiteboard
from llfsm.whiteboard.liveness import born, host_name, pid_namespace
from llfsm.whiteboard.messages.llfsm import MachineStatus, OverriddenSensor, status_slot
from waiting import wait_for

from .conftest import MACHINES, Llfsm, rows, wait_for_line


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


def test_ps_shows_what_machines_wait_for(llfsm: Llfsm, board: str) -> None:
    with Whiteboard(board) as wb:
        run = MachineStatus(
            "A", pid=os.getpid(), born=born(os.getpid()), host=host_name(),
            namespace=pid_namespace(),
        )  # fmt: skip
        wb.add_message(status_slot("Polls"), run)
        assert llfsm.run("ps", "-b", board).stdout.splitlines()[0].endswith("PID")
        wb.add_message(status_slot("Waits"), replace(run, waits="door or 32 s"))
        head, *lines = llfsm.run("ps", "-b", board).stdout.splitlines()
    assert head.endswith("  WAITS FOR")
    assert [line.endswith("  door or 32 s") for line in lines] == [False, True]


def test_a_machine_that_waits_says_for_what(llfsm: Llfsm, board: str, tmp_path: Path) -> None:
    (tmp_path / "waits.py").write_text(WAITS)

    def waits_for() -> str:
        return str(rows(llfsm, "-b", board).get("Waits", {}).get("waits"))

    with Whiteboard(board):  # it is there before the machine
        llfsm.start("run", "waits.py:Waits", "-q", "-b", board)
        wait_for(lambda: waits_for() == "door or 32 s", "it waits")
        llfsm.run("suspend", "Waits", "-b", board)
        wait_for(lambda: waits_for() == "", "nothing but requests ends that")


WAITS = """
from llfsm.runtime import Machine, Sensor, State
from llfsm.whiteboard import Slot
from llfsm.whiteboard.messages.std_msgs import Bool

class Waits(Machine):
    door = Sensor(Slot("door", Bool), default=Bool())
    rest, go = State(), State(final=False)
    rest.to(go, when=lambda self: self.door.data)
    rest.to(go, after=32)
"""


def test_ps_is_json_for_programs(llfsm: Llfsm, board: str, running: subprocess.Popen[str]) -> None:
    reported = rows(llfsm, "-b", board)
    assert list(reported) == ["Stays", "Stubborn"]
    row = reported["Stays"]
    assert row["in_state_s"] >= row["silent_s"] >= 0
    assert row["ringlets"] > 0
    assert (row["realtime"], row["cpu"]) == (None, None)
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


def test_ps_shows_the_priority_and_the_core(llfsm: Llfsm, board: str) -> None:
    core = min(os.sched_getaffinity(0))
    process = llfsm.start(
        "run", f"{MACHINES}:Stays", "-q", "-b", board, "--cpu", str(core), "--realtime", "3"
    )
    line = process.stdout.readline()
    if "limits.conf" in line:
        pytest.skip("no right to run in real time")
    assert "Stays entered A" in line
    head, row = llfsm.run("ps", "-b", board).stdout.splitlines()
    assert head.split()[-1] == "REALTIME"
    assert row.endswith(f"FIFO 3 on core {core}")
    reported = rows(llfsm, "-b", board)["Stays"]
    assert (reported["realtime"], reported["cpu"]) == (3, core)


def test_ps_of_every_board(llfsm: Llfsm, board: str, running: subprocess.Popen[str]) -> None:
    done = llfsm.run("ps", "-a")
    assert done.returncode == 0
    head, *lines = [line.split() for line in done.stdout.splitlines()]
    assert head[:2] == ["WHITEBOARD", "MACHINE"]
    assert [line[1] for line in lines if line[0] == board] == ["Stays", "Stubborn"]
    reported = [json.loads(line) for line in llfsm.run("ps", "-a", "--json").stdout.splitlines()]
    assert [row["machine"] for row in reported if row["whiteboard"] == board] == [
        "Stays",
        "Stubborn",
    ]


def there(name: str) -> BoardPlace:
    return BoardPlace(name, "/dev/shm")


def test_ps_of_every_board_although_one_goes_meanwhile(
    board: str, running: subprocess.Popen[str]
) -> None:
    [found] = listings([there(f"{board}-not"), there(board)])
    assert found.board == board
    assert [machine.name for machine in found.machines] == ["Stays", "Stubborn"]


def test_ps_of_every_board_although_one_cannot_be_read(
    board: str, running: subprocess.Popen[str], capsys: pytest.CaptureFixture[str]
) -> None:
    broken = Path(f"/dev/shm/llfsm.{board}-broken")
    broken.write_bytes(b"no whiteboard")
    try:
        [found] = listings([there(f"{board}-broken"), there(board)])
    finally:
        broken.unlink()
    assert f"whiteboard '{board}-broken': " in capsys.readouterr().err
    assert [machine.name for machine in found.machines] == ["Stays", "Stubborn"]


def test_ps_of_a_board_without_machines(llfsm: Llfsm, board: str) -> None:
    with Whiteboard(board):
        assert rows(llfsm, "-b", board) == {}
        done = llfsm.run("ps", "-b", board)
    reported = f"no machine runs on whiteboard {board}; start one: llfsm run MACHINE -b {board}\n"
    assert (done.returncode, done.stdout) == (0, reported)


def test_machines_of_one_name_are_told_apart(
    llfsm: Llfsm, board: str, running: subprocess.Popen[str]
) -> None:
    second = llfsm.start("run", f"{MACHINES}:Stays", "-q", "-b", board)
    wait_for_line(second, "Stays entered A")
    reported = {name: row["pid"] for name, row in rows(llfsm, "-b", board).items()}
    assert reported == {"Stays": running.pid, "Stays.0": second.pid, "Stubborn": running.pid}
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


def test_two_commanders_of_a_slot_are_shown(llfsm: Llfsm, board: str) -> None:
    first = llfsm.start(
        "run", f"{commanding.__file__}:Wall", f"{MACHINES}:Stubborn", "-q", "-b", board
    )
    with Whiteboard(board) as wb:
        wait_for(lambda: wb[status_slot("Wall")].count, "the first is published")
        assert "commanders" not in llfsm.run("ps", "-b", board).stdout
        second = llfsm.start("run", f"{commanding.__file__}:Blind", "-q", "-b", board)
        line = f"cmd has two commanders: Wall (pid {first.pid}), Blind (pid {second.pid})\n"
        assert wait_for_line(first, "commanders") == line
        assert wait_for_line(second, "commanders") == line
        wait_for(lambda: wb[status_slot("Blind")].count, "the second is published")
    assert llfsm.run("ps", "-b", board).stdout.endswith(line)
    assert llfsm.run("whiteboard", "list", board).stdout.endswith(line)
    contested = {name: row["contested"] for name, row in rows(llfsm, "-b", board).items()}
    assert contested == {"Wall": ["cmd"], "Blind": ["cmd"], "Stubborn": []}
    second.kill()
    second.wait()
    assert "commanders" not in llfsm.run("ps", "-b", board).stdout
    assert "commanders" not in llfsm.run("whiteboard", "list", board).stdout


def test_a_second_exclusive_commander_does_not_start(llfsm: Llfsm, board: str) -> None:
    first = llfsm.start("run", f"{commanding.__file__}:Alone", "-q", "-b", board)
    with Whiteboard(board) as wb:
        wait_for(lambda: wb[status_slot("Alone")].count, "the first is published")
    done = llfsm.run("run", f"{commanding.__file__}:Alone", "-q", "-b", board)
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr == (
        f"Error: Alone posts to 'cmd' exclusively, but Alone (pid {first.pid}, exclusive) "
        f"does, too; end that machine first\n"
    )


def test_ps_needs_a_board(llfsm: Llfsm, board: str) -> None:
    done = llfsm.run("ps", "-b", board)
    assert (done.returncode, done.stdout) == (1, "")
    assert f"{board}: no such whiteboard" in done.stderr


def test_ps_shows_who_called_a_machine_and_how_long_an_override_lasts(
    llfsm: Llfsm, board: str
) -> None:
    override = OverriddenSensor("pose", 7.0)
    status = MachineStatus(
        "A", pid=os.getpid(), born=born(os.getpid()), host=host_name(), namespace=pid_namespace()
    )
    called = replace(status, caller="Boss", overridden=(override, OverriddenSensor("odom")))
    with Whiteboard(board) as wb:
        wb.add_message(status_slot("Count"), called)
        wb.add_message(status_slot("Boss"), status)
        lines = llfsm.run("ps", "-b", board).stdout.splitlines()
        reported = rows(llfsm, "-b", board)
    assert lines[-3] == "Count is called by Boss"
    assert re.fullmatch(r"Count: its sensor pose is overridden, for [0-7] s more", lines[-2])
    assert lines[-1] == "Count: its sensor odom is overridden, until it is released"
    assert (reported["Count"]["caller"], reported["Boss"]["caller"]) == ("Boss", "")
    assert 0 <= reported["Count"]["overridden"].pop("pose") <= 7
    assert reported["Count"]["overridden"] == {"odom": None}


def test_ps_lists_each_machine_once_whatever_is_said_of_its_caller(
    llfsm: Llfsm, board: str
) -> None:
    status = MachineStatus(
        "A", pid=os.getpid(), born=born(os.getpid()), host=host_name(), namespace=pid_namespace()
    )
    callers = {
        "Boss/Inner/Innermost": "Boss/Inner",
        "Boss/Inner": "Boss",
        "Boss": "",
        "Itself": "Itself",
        "One": "Other",
        "Other": "One",
        "Orphan": "Gone",
    }
    with Whiteboard(board) as wb:
        for name, caller in callers.items():
            wb.add_message(status_slot(name), replace(status, caller=caller))
        lines = llfsm.run("ps", "-b", board).stdout.splitlines()[1 : len(callers) + 1]
    names = [line.partition(" A ")[0].rstrip() for line in lines]
    assert names[:4] == ["Boss", "  Boss/Inner", "    Boss/Inner/Innermost", "Orphan"]
    assert sorted(name.strip() for name in names) == sorted(callers)
