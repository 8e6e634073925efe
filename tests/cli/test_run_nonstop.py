"""`llfsm run -n`: an arrangement that crashes is started again, and one that ends is not."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from forked import Forked
from waiting import PATIENCE_S, wait_for

from .conftest import Llfsm, alive, exists, offspring, wait_for_line

MODULE = """
import os
import signal
import time
from pathlib import Path

from llfsm.runtime import Machine, State

print("imported")

class Crasher(Machine):
    how: str = "raise"
    entered: int = 0
    A = State()
    B = State()

    @A.on_entry
    def _(self):
        self.entered += 1
        with open("runs", "a") as runs:
            runs.write("x")
        run = Path("runs").stat().st_size
        print(f"run {run}, entered {self.entered}", flush=True)
        if run > 1:
            return
        if self.how == "raise":
            raise RuntimeError("crashed indeed")
        os.kill(os.getpid(), getattr(signal, self.how))

    A.to(B)

class Says(Machine):
    A = State()

    @A.on_entry
    def _(self):
        with open("runs", "a") as runs:
            runs.write("x")
        print("said")

class Stays(Machine):
    A = State()
    STOPPING = State()
    B = State()

    @A.on_entry
    def _(self):
        print("entered A", flush=True)

    @B.on_entry
    def _(self):
        print("ended well", flush=True)

    A.to(STOPPING, when=lambda m: m.stopping)
    STOPPING.to(B, after_ms=200)
"""

# A signal that comes just before the fork.
EARLY = """
import os, signal, time
from llfsm.cli.run.running import run_nonstop

block = signal.pthread_sigmask

def signalled(*arguments):
    signal.pthread_sigmask = block
    os.kill(os.getpid(), signal.SIGTERM)
    return block(*arguments)

signal.pthread_sigmask = signalled
run_nonstop(lambda: time.sleep(60), lambda cause: os._exit(0))
"""

# A signal that the system gives to another thread than the one that waits, and handles signals.
ELSEWHERE = """
import os, signal, threading, time
from llfsm.cli.run.running import run_nonstop

reader, writer = os.pipe()

def take():
    os.read(reader, 1)
    signal.pthread_kill(threading.get_ident(), signal.SIGTERM)

def run():
    os.write(writer, b"x")
    time.sleep(60)

threading.Thread(target=take, daemon=True).start()
run_nonstop(run, lambda cause: os._exit(0))
"""


@pytest.fixture(autouse=True)
def module(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(MODULE)


def child_of(process: subprocess.Popen[str]) -> int:
    """Return the process that runs the arrangement, as soon as there is one."""
    wait_for(lambda: offspring(process.pid), "a child that runs the arrangement")
    (child,) = offspring(process.pid)
    return child


def pending(pid: int, number: signal.Signals) -> bool:
    """Tell whether a process has still to take a signal, which it does not hold off."""
    status = dict(
        line.split(":\t") for line in Path(f"/proc/{pid}/status").read_text().splitlines()
    )
    sent, blocked = int(status["ShdPnd"], 16), int(status["SigBlk"], 16)
    return bool((sent & ~blocked) >> (number - 1) & 1)


@pytest.mark.parametrize(
    ("how", "printed"),
    [
        ("raise", "the arrangement failed; it starts again"),
        ("SIGKILL", "the arrangement was killed by SIGKILL; it starts again"),
        ("SIGSEGV", "the arrangement was killed by SIGSEGV; it starts again"),
    ],
)
def test_a_crash_is_reported_and_all_starts_afresh(
    llfsm: Llfsm, board: str, how: str, printed: str
) -> None:
    arguments = ["mine:Crasher", f"Crasher:how={how}", "-q", "--remove-board", "-b", board]
    done = llfsm.run_forked("run", "-n", *arguments)
    assert done.returncode == 0, done.stderr
    assert [line for line in done.stdout.splitlines() if line.startswith("run")] == [
        "run 1, entered 1",
        "run 2, entered 1",
    ]
    lines = done.stderr.splitlines()
    assert lines[-1] == printed
    if how == "raise":
        (error,) = lines[:-1]
        assert error.startswith("Error: machine Crasher, state A, OnEntry: RuntimeError: crashed")
    assert not exists(board)


def test_debug_shows_the_traceback_of_a_crash(llfsm: Llfsm, board: str) -> None:
    done = llfsm.run_forked("--debug", "run", "-n", "mine:Crasher", "-q", "-b", board)
    assert done.returncode == 0
    assert "Traceback" in done.stderr
    assert done.stderr.splitlines()[-1] == "the arrangement failed; it starts again"


def test_a_normal_end_ends_it(llfsm: Llfsm, board: str) -> None:
    (llfsm.cwd / "runs").write_text("x")  # so that it does not crash
    done = llfsm.run_forked("run", "-n", "mine:Crasher", "-t", "-q", "-b", board)
    assert done.returncode == 0
    assert done.stderr.startswith("machine  ringlets")
    assert "run 2, entered 1\n" in done.stdout
    assert (llfsm.cwd / "runs").read_text() == "xx"
    assert exists(board)


def test_what_was_printed_before_is_not_printed_again(
    llfsm: Llfsm, board: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("PYTHONUNBUFFERED", raising=False)
    (llfsm.cwd / "runs").write_text("x")
    done = llfsm.run_apart("run", "-n", "mine:Crasher", "-q", "-b", board)
    assert done.stdout == "imported\nrun 2, entered 1\n"


def test_an_end_without_anybody_who_listens_is_an_end(
    llfsm: Llfsm, board: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("PYTHONUNBUFFERED", raising=False)
    (llfsm.cwd / "quiet.py").write_text(MODULE.replace('print("imported")', ""))
    process = llfsm.start("run", "-n", "quiet:Says", "-q", "-b", board)
    process.stdout.close()
    assert process.wait(PATIENCE_S) == 0
    assert (llfsm.cwd / "runs").read_text() == "x"


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_ends_all(llfsm: Llfsm, board: str, number: signal.Signals) -> None:
    process = llfsm.start("run", "-n", "mine:Stays", "-q", "--remove-board", "-b", board)
    wait_for_line(process, "entered A")
    child = child_of(process)
    process.send_signal(number)
    rest = process.stdout.read()
    assert process.wait() == 0
    assert rest == "ended well\n"
    assert not alive(child)
    assert not exists(board)


def test_a_terminals_interrupt_leaves_the_machines_their_time(llfsm: Llfsm, board: str) -> None:
    """It reaches the supervisor and, in the same group of processes, the arrangement too."""
    process = llfsm.start("run", "-n", "mine:Stays", "-q", "-b", board)
    wait_for_line(process, "entered A")
    child = child_of(process)
    os.kill(child, signal.SIGINT)
    wait_for(lambda: not pending(child, signal.SIGINT), "the arrangement has got the signal")
    process.send_signal(signal.SIGINT)
    rest = process.stdout.read()
    assert process.wait() == 0
    assert rest == "ended well\n"
    assert not alive(child)


def test_a_signal_while_it_waits_to_start_again_ends_it(llfsm: Llfsm, board: str) -> None:
    process = llfsm.start("run", "-n", "mine:Crasher", "-q", "-b", board)
    wait_for_line(process, "it starts again")
    process.send_signal(signal.SIGTERM)
    assert process.wait() == 0
    assert (llfsm.cwd / "runs").read_text() == "x"


@pytest.mark.parametrize("script", [EARLY, ELSEWHERE], ids=["just before the fork", "elsewhere"])
def test_a_signal_that_interrupts_no_wait_is_not_lost(script: str) -> None:
    process = subprocess.Popen([sys.executable, "-c", script], start_new_session=True)
    try:
        assert process.wait(PATIENCE_S) == 0
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()


def test_the_end_of_input_ends_all(llfsm: Llfsm, board: str) -> None:
    process = Forked(
        [sys.executable, "-m", "llfsm.cli", "run", "-n", "mine:Stays", "--until-eof", "-q",
         "-b", board],
        cwd=llfsm.cwd,
        text=True,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
    )  # fmt: skip
    llfsm.started.append(process)
    wait_for_line(process, "entered A")
    child = child_of(process)
    process.stdin.close()
    assert process.stdout.read() == "ended well\n"
    assert process.wait() == 0
    assert not alive(child)


def test_a_killed_supervisor_takes_the_arrangement_with_it(llfsm: Llfsm, board: str) -> None:
    process = llfsm.start("run", "-n", "mine:Stays", "-q", "-b", board)
    wait_for_line(process, "entered A")
    child = child_of(process)
    process.kill()
    process.wait()
    try:
        wait_for(lambda: not alive(child), "the arrangement ends")
    finally:
        if alive(child):
            os.kill(child, signal.SIGKILL)
    assert process.stdout.read() == "ended well\n"


@pytest.mark.parametrize(
    ("arguments", "status", "printed"),
    [
        (["mine:Nobody"], 2, "mine has no 'Nobody'"),
        (["mine:Crasher", "Crasher:color=1"], 2, "no variable 'color'"),
        (["wrong.toml"], 1, "wrong.toml:2: "),
        (["load.toml"], 1, "entered = 'x'"),
    ],
)
def test_what_cannot_be_loaded_is_not_tried_again(
    llfsm: Llfsm, board: str, arguments: list[str], status: int, printed: str
) -> None:
    (llfsm.cwd / "wrong.toml").write_text("[[machine]]\ndefinition = 1\n")
    (llfsm.cwd / "load.toml").write_text(
        "[[machine]]\ndefinition = 'mine:Crasher'\nvariables.entered = 'x'\n"
    )
    done = llfsm.run_forked("run", "-n", *arguments, "-q", "-b", board)
    assert done.returncode == status
    assert printed in done.stderr
    assert "again" not in done.stderr
    assert not (llfsm.cwd / "runs").exists()


def test_ps_shows_the_new_process(llfsm: Llfsm, board: str) -> None:
    process = llfsm.start("run", "-n", "mine:Stays", "-q", "-b", board)
    wait_for_line(process, "entered A")
    first = child_of(process)
    os.kill(first, signal.SIGKILL)
    wait_for_line(process, "was killed by SIGKILL; it starts again")
    wait_for_line(process, "entered A")
    second = child_of(process)
    (reported,) = [
        json.loads(line) for line in llfsm.run("ps", "--json", "-b", board).stdout.splitlines()
    ]
    assert (reported["machine"], reported["pid"], second == first) == ("Stays", second, False)
