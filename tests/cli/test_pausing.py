"""`llfsm pause`, `step` and `continue`, and what else happens to a process that is paused."""

from __future__ import annotations

import re
import signal
import subprocess
import threading
from contextlib import closing

from llfsm.runtime import Arrangement, Machine, Sensor, State
from llfsm.runtime.presence.guard import Guard
from llfsm.runtime.presence.remote import Directory
from llfsm.whiteboard import Slot, Whiteboard
from llfsm.whiteboard.messages.llfsm import MachineRequest
from llfsm.whiteboard.messages.std_msgs import Int32
from waiting import wait_for

from .conftest import MACHINES, Llfsm, rows, wait_for_line


class Driver(Machine):
    """Wait while something is near."""

    pose = Sensor(Slot("pose", Int32), default=Int32())

    going = State()
    waiting = State()

    going.to(waiting, when=lambda m: m.pose.data > 9)
    waiting.to(going, when=lambda m: m.pose.data <= 9)


def test_pause_step_and_continue(llfsm: Llfsm, board: str, running: subprocess.Popen[str]) -> None:
    done = llfsm.run("pause", "-b", board, "--for", "900")
    assert (done.returncode, done.stderr) == (0, "")
    assert "until `llfsm continue`\n" in done.stdout
    assert "the states' clocks run on; the machines continue in 900 s" in done.stdout
    done = llfsm.run("pause", "-b", board, "--for", "2")  # which does not shorten it
    assert re.search("the machines continue in [89].. s", done.stdout)
    assert " 2 s" not in done.stdout
    found = rows(llfsm, "-b", board)
    assert {row["status"] for row in found.values()} == {"paused"}
    ringlets = found["Stubborn"]["ringlets"]
    listed = llfsm.run("ps", "-b", board).stdout
    why, how = listed.splitlines()[-2:]
    assert why == f"the machines of process {running.pid} are paused: pause"
    clock = "the states' clocks run on"
    assert re.fullmatch(
        rf"  {clock}; the machines continue in \d+ s unless the pause is renewed", how
    )
    row = found["Stubborn"]
    assert (row["clock"], 0 < row["paused_left_s"] <= 900) == ("runs", True)
    for number in (1, 2):
        done = llfsm.run("step", "Stubborn", "--until", "round", "-b", board, "--for", "900")
        assert done.stdout == "paused in A (step: round)\n"
        assert rows(llfsm, "-b", board)["Stubborn"]["ringlets"] <= ringlets + number
    done = llfsm.run("continue", "-b", board)
    assert done.stdout == "running in A\n"
    wait_for(lambda: rows(llfsm, "-b", board)["Stubborn"]["ringlets"] > ringlets + 2)


def test_a_paused_process_ends_with_a_signal(
    llfsm: Llfsm, board: str, running: subprocess.Popen[str]
) -> None:
    assert llfsm.run("pause", "Stays", "-b", board).returncode == 0
    running.terminate()
    assert "ended well" in wait_for_line(running, "Stays")
    assert running.wait() == 0


def test_a_paused_process_that_is_killed_is_guarded(llfsm: Llfsm, board: str) -> None:
    process = llfsm.start("run", f"{MACHINES}:Lamp", "-q", "-b", board)
    wait_for_line(process, "lit")
    with Whiteboard(board, create=False) as wb, closing(Guard(wb)) as guard:
        assert llfsm.run("pause", "Lamp", "-b", board).returncode == 0
        process.send_signal(signal.SIGKILL)
        process.wait()
        wait_for(lambda: (guard.look(), wb[wb.find("lamp")].get().data)[1] == 0, "the safe value")


def test_a_pause_that_nobody_renews_ends(
    llfsm: Llfsm, board: str, running: subprocess.Popen[str]
) -> None:
    done = llfsm.run("pause", "Stays", "--for", "0.1", "-b", board)
    assert done.returncode == 0
    wait_for(lambda: rows(llfsm, "-b", board)["Stays"]["status"] == "running")
    assert "nobody has renewed the pause" in wait_for_line(running, "renewed")


def test_a_sensor_is_overridden_and_released(llfsm: Llfsm, board: str) -> None:
    with Whiteboard(board) as wb:
        arrangement = Arrangement([Driver], whiteboard=wb)
        thread = threading.Thread(target=arrangement.run, kwargs={"grace_s": 0.0})
        thread.start()
        wait_for(lambda: "Driver" in rows(llfsm, "-b", board))
        done = llfsm.run("override", "Driver", "pose", '{"data": 12}', "-b", board)
        assert (done.returncode, done.stdout) == (
            0,
            "Driver: pose is overridden until `--release`, or for 60 s\n",
        )
        wait_for(lambda: rows(llfsm, "-b", board)["Driver"]["state"] == "waiting")
        (left_s,) = rows(llfsm, "-b", board)["Driver"]["overridden"].values()
        assert 0 <= left_s <= 60
        last = llfsm.run("ps", "-b", board).stdout.splitlines()[-1]
        assert re.fullmatch(r"Driver: its sensor pose is overridden, for \d+ s more", last)
        refused = llfsm.run("override", "Driver", "pos", "{}", "-b", board)
        assert refused.returncode == 1
        assert "Error: Driver has no sensor 'pos'; it has: pose; did you mean" in refused.stderr
        done = llfsm.run("override", "Driver", "pose", "--release", "-b", board)
        assert (done.returncode, done.stdout) == (0, "Driver: pose is released\n")
        wait_for(lambda: rows(llfsm, "-b", board)["Driver"]["state"] == "going")
        arrangement.stop()
        thread.join()
    usage = llfsm.run("override", "Driver", "pose", "-b", board)
    assert (usage.returncode, "give either a MESSAGE or --release" in usage.stderr) == (2, True)


def test_which_process_must_be_clear(
    llfsm: Llfsm, board: str, running: subprocess.Popen[str]
) -> None:
    other = llfsm.start("run", f"Other={MACHINES}:Stays", "-q", "-b", board)
    wait_for_line(other, "Other entered A")
    wait_for(lambda: "Other" in rows(llfsm, "-b", board))
    done = llfsm.run("pause", "-b", board)
    assert done.returncode == 2
    assert "2 processes run machines: name one of" in done.stderr
    assert "no machine 'Othr'" in llfsm.run("pause", "Othr", "-b", board).stderr


def test_a_pause_says_that_the_clocks_stand_still(llfsm: Llfsm, board: str) -> None:
    process = llfsm.start("run", f"{MACHINES}:Stays", "-q", "-b", board, "--debug-clock")
    wait_for_line(process, "entered A")
    assert "the states' clocks stand still" in llfsm.run("pause", "-b", board).stdout


def test_a_process_that_is_stopped_is_named(
    llfsm: Llfsm, board: str, running: subprocess.Popen[str], monkeypatch
) -> None:
    monkeypatch.setattr("llfsm.runtime.presence.remote.PATIENCE_S", 0.1)
    running.send_signal(signal.SIGSTOP)
    try:
        wait_for(lambda: rows(llfsm, "-b", board)["Stays"]["status"] == "silent")
        done = llfsm.run("step", "Stays", "-b", board)
    finally:
        running.send_signal(signal.SIGCONT)
    assert re.search(r"its process is silent for \d+ s; is it stopped\?", done.stderr)


def test_a_clock_of_others_cannot_stand_still(llfsm: Llfsm) -> None:
    done = llfsm.run("run", "RosPingPong", "--ros-time", "--debug-clock")
    assert done.returncode == 2
    assert "the time on /clock passes with its publisher: no --debug-clock" in done.stderr


def test_there_must_be_a_machine(llfsm: Llfsm, board: str) -> None:
    with Whiteboard(board):
        done = llfsm.run("pause", "-b", board)
    assert (done.returncode, done.stderr) == (1, f"Error: no machine runs on {board}\n")


def test_a_step_that_is_not_over_goes_on(
    llfsm: Llfsm, board: str, running: subprocess.Popen[str], monkeypatch
) -> None:
    monkeypatch.setattr("llfsm.runtime.presence.remote.PATIENCE_S", 0.2)
    done = llfsm.run("step", "Stubborn", "--until", "leave", "-b", board)
    assert done.returncode == 1
    assert "has not reached that within 0.2 s: it runs on until it does" in done.stderr
    with Whiteboard(board, create=False) as wb:
        Directory(wb).find("Stubborn").send(MachineRequest("continue"))
