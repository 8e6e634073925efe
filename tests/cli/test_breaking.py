"""`llfsm run --break` and `llfsm why`, and breakpoints in arrangement files."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

from llfsm.runtime.presence.remote import Directory
from llfsm.whiteboard import Whiteboard
from llfsm.whiteboard.messages.llfsm import MachineRequest
from waiting import wait_for

from .conftest import MACHINES, Llfsm, rows, wait_for_line


def test_why_a_machine_stays(llfsm: Llfsm, board: str, running: subprocess.Popen[str]) -> None:
    done = llfsm.run("why", "Stays", "-b", board)
    assert (done.returncode, done.stderr) == (0, "")
    head, row = done.stdout.splitlines()
    assert re.fullmatch(r"it is in A, evaluated \d+\.\d{3} s ago:", head)
    assert row == "  false  -> B  m.stopping  stopping=False"
    assert "no machine 'Nobody'" in llfsm.run("why", "Nobody", "-b", board).stderr


def test_why_a_machine_has_left(llfsm: Llfsm, board: str) -> None:
    """At a breakpoint, with what was seen by the transition that has fired."""
    process = llfsm.start("run", f"{MACHINES}:Stays", "-q", "-b", board, "--break", "Stays:B")
    wait_for_line(process, "Stays entered A")
    with Whiteboard(board, create=False) as wb:
        Directory(wb).find("Stays").send(MachineRequest("stop"))
    wait_for(lambda: rows(llfsm, "-b", board)["Stays"]["paused"] == "breakpoint Stays:B")
    done = llfsm.run("why", "Stays", "-b", board)
    assert done.stdout == "it has left A:\n  true   -> B  m.stopping  stopping=True\nit is in B\n"
    llfsm.run("continue", "-b", board)
    assert "ended well" in wait_for_line(process, "ended well")
    assert process.wait() == 0


def test_a_breakpoint_in_code_pauses_where_there_is_no_terminal(
    llfsm: Llfsm, board: str, tmp_path: Path
) -> None:
    file = tmp_path / "halts.py"
    file.write_text(
        "from llfsm.runtime import Machine, State\n"
        "class Halts(Machine):\n"
        "    a = State()\n"
        "    b = State()\n"
        "    @a.on_entry\n"
        "    def _(self) -> None:\n"
        "        print('halts', flush=True)\n"
        "        breakpoint()\n"
        "    a.to(b, when=lambda m: m.stopping)\n"
    )
    process = llfsm.start("run", f"{file}:Halts", "-q", "-b", board)
    wait_for_line(process, "halts")
    why = "breakpoint() in halts.py:8"
    wait_for(lambda: rows(llfsm, "-b", board)["Halts"]["paused"] == why)
    assert rows(llfsm, "-b", board)["Halts"]["paused_left_s"] > 0
    llfsm.run("continue", "-b", board)
    assert llfsm.run("stop", "Halts", "-b", board).returncode == 0
    assert process.wait() == 0


def test_a_wrong_breakpoint_runs_nothing(llfsm: Llfsm, board: str) -> None:
    done = llfsm.run("run", f"{MACHINES}:Stays", "-q", "-b", board, "--break", "Stays:C")
    assert done.returncode == 1
    assert done.stdout == ""
    assert "no state of Stays 'C'; there are: A, B" in done.stderr


def test_an_arrangement_file_has_breakpoints(llfsm: Llfsm, board: str, tmp_path: Path) -> None:
    file = tmp_path / "stays.toml"
    text = f'on_pause = "safe"\n[[machine]]\ndefinition = "{MACHINES}:Stays"\n'
    file.write_text('break = ["Stays:C"]\n' + text)
    done = llfsm.run("check", str(file))
    assert done.returncode == 1
    assert "breakpoint 'Stays:C': no state of Stays 'C'; there are: A, B" in done.stdout
    assert "no state of Stays 'C'" in llfsm.run("run", str(file), "-q", "-b", board).stderr
    file.write_text('break = ["Stays:B"]\n' + text)
    done = llfsm.run("check", str(file))
    assert done.returncode == 0, done.stdout
