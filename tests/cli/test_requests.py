"""`llfsm suspend`, `resume`, `restart`, `reload`, `stop`: requests to other processes' machines."""

from __future__ import annotations

import signal
import subprocess

import click
import pytest

from llfsm.cli.requests import carry_out, fetch_why
from llfsm.whiteboard import Whiteboard
from llfsm.whiteboard.messages.llfsm import Action, MachineStatus, request_slot, status_slot
from waiting import wait_for

from .conftest import MACHINES, Llfsm, rows, wait_for_line


def test_suspend_and_resume(llfsm: Llfsm, board: str, running: subprocess.Popen[str]) -> None:
    done = llfsm.run("suspend", "Stays", "-b", board)
    assert (done.returncode, done.stdout) == (0, "Stays is suspended in Suspended\n")
    assert "suspended" in wait_for_line(running, "Stays")
    reported = rows(llfsm, "-b", board)
    assert (reported["Stays"]["status"], reported["Stubborn"]["status"]) == ("suspended", "running")
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


def test_reload(llfsm: Llfsm, board: str, running: subprocess.Popen[str]) -> None:
    done = llfsm.run("reload", "Stays", "-b", board)
    assert (done.returncode, done.stdout) == (1, "")
    assert "Stays is not reloaded: " in done.stderr
    assert "only a .machine bundle can be reloaded" in done.stderr
    assert "Stays is not reloaded: " in llfsm.run("ps", "-b", board).stdout
    assert "only a .machine bundle" in rows(llfsm, "-b", board)["Stays"]["refusal"]
    assert llfsm.run("new", "Blink", "--bundle").returncode == 0
    bundle = llfsm.cwd / "Blink.machine"
    (bundle / "State_COUNT_Transition_1.expr").write_text("after(3600)\n")
    process = llfsm.start("run", "Blink.machine", "-q", "-b", board)
    with Whiteboard(board, create=False) as wb:
        status = wb[status_slot("Blink")]
        wait_for(lambda: status.count, "it is published")
    entry = bundle / "State_COUNT_OnEntry.py"
    entry.write_text("print('as it is now', flush=True)\n")
    done = llfsm.run("reload", "Blink", "-b", board)
    assert done.stdout.startswith("Blink is reloaded and running again in "), done.stderr
    wait_for_line(process, "as it is now")
    entry.write_text("count +=\n")
    done = llfsm.run("reload", "Blink", "-b", board)
    assert done.returncode == 1
    assert "State_COUNT_OnEntry.py:1: " in done.stderr
    assert process.poll() is None


def test_stop_ends_one_machine(llfsm: Llfsm, board: str, running: subprocess.Popen[str]) -> None:
    done = llfsm.run("stop", "Stays", "-b", board)
    assert (done.returncode, done.stdout) == (0, "Stays has ended\n")
    assert "ended well" in wait_for_line(running, "Stays")
    assert list(rows(llfsm, "-b", board)) == ["Stubborn"]
    done = llfsm.run("stop", "Stubborn", "-b", board)  # it is unloaded, as it does not listen
    assert (done.returncode, done.stdout) == (0, "Stubborn has ended\n")
    assert running.wait() == 0


def test_a_lone_machine_suspended_from_outside_may_be_resumed(llfsm: Llfsm, board: str) -> None:
    process = llfsm.start("run", f"{MACHINES}:Stays", "-q", "-b", board)
    wait_for_line(process, "Stays entered A")
    assert llfsm.run("suspend", "Stays", "-b", board).returncode == 0
    with Whiteboard(board, create=False) as wb:
        slot = wb[status_slot("Stays")]
        count = slot.count
        wait_for(lambda: slot.count > count + 1, "it is still reported")
    assert process.poll() is None
    assert llfsm.run("resume", "Stays", "-b", board).returncode == 0
    assert llfsm.run("stop", "Stays", "-b", board).returncode == 0
    assert process.stdout.read().endswith("resumed\nStays entered A\nStays ended well\n")
    assert process.wait() == 0


def test_a_lone_machine_suspended_from_outside_ends_with_a_signal(llfsm: Llfsm, board: str) -> None:
    process = llfsm.start("run", f"{MACHINES}:Stays", "-q", "-b", board)
    wait_for_line(process, "Stays entered A")
    assert llfsm.run("suspend", "Stays", "-b", board).returncode == 0
    process.terminate()
    assert process.wait() == 0


def test_a_lone_machine_that_suspends_itself_is_not_waited_for(llfsm: Llfsm, board: str) -> None:
    assert llfsm.run("run", f"{MACHINES}:Shy", "-q", "-b", board).returncode == 0


# What cannot be done


@pytest.mark.parametrize("action", ["suspend", "resume", "restart", "reload", "stop"])
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


@pytest.mark.parametrize("action", ["suspend", "resume", "restart", "reload", "stop"])
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
    process = llfsm.start("run", f"{MACHINES}:Stays", "--period", "900000000", "-q", "-b", board)
    wait_for_line(process, "Stays entered A")
    with Whiteboard(board, create=False) as wb:
        with pytest.raises(click.ClickException, match="did not carry out the request"):
            carry_out(wb, "Stays", "restart", patience_s=0.5)
        reported = wb[status_slot("Stays")]
        wait_for(lambda: reported.get().pending == "restart", "the request is reported")


def test_the_reason_of_a_machine_that_has_just_ended_is_that() -> None:
    board = Whiteboard.local()
    board.add_message(status_slot("Mission/Drive"), MachineStatus("there", loaded=False))
    with pytest.raises(click.ClickException, match=r"^Mission/Drive has ended$"):
        fetch_why(board, "Mission/Drive")
