"""Machines of processes that have died, stand still or are on another host: which of them live."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from llfsm.runtime import UnknownMachineError
from llfsm.runtime.presence.remote import SILENT_S, Directory, is_live
from llfsm.whiteboard import Sample, Whiteboard
from llfsm.whiteboard.liveness import born, host_name, pid_namespace
from llfsm.whiteboard.messages.llfsm import MachineStatus
from waiting import wait_for

from .workers import Processes


def test_a_machine_of_a_process_that_was_killed_is_unknown(board: Whiteboard, processes: Processes):
    worker = processes.run("Worker")
    worker.kill()
    worker.wait()
    with pytest.raises(UnknownMachineError, match=r"no machine 'Worker'; on .*: none$"):
        Directory(board).find("Worker")
    assert Directory(board).machines() == []


def test_a_machine_of_a_killed_process_that_nobody_waits_for_is_unknown_within_a_second(
    board: Whiteboard, processes: Processes
):
    worker = processes.run("Worker")
    worker.kill()
    os.waitid(os.P_PID, worker.pid, os.WEXITED | os.WNOWAIT)  # it is dead, and stays a zombie
    until = time.monotonic() + SILENT_S
    wait_for(lambda: time.monotonic() >= until, "time stands still")
    assert Directory(board).machines() == []


def test_its_name_is_free_for_the_next_process(board: Whiteboard, processes: Processes):
    worker = processes.run("Worker")
    worker.kill()
    worker.wait()
    processes.run("Worker")
    assert [machine.name for machine in Directory(board).machines()] == ["Worker"]


def test_a_stopped_process_is_listed_and_its_silence_grows(board: Whiteboard, processes: Processes):
    worker = processes.run("Worker")
    worker.send_signal(signal.SIGSTOP)
    wait_for(lambda: Directory(board).find("Worker").silent_s > SILENT_S + 0.1, "not silent")
    (machine,) = Directory(board).machines()
    assert (machine.name, machine.state, machine.suspended) == ("Worker", "WORK", False)
    assert machine.silent_s > SILENT_S
    assert machine.in_state_s > SILENT_S
    worker.send_signal(signal.SIGCONT)
    wait_for(lambda: Directory(board).find("Worker").silent_s < SILENT_S, "still silent")


ME = {
    "pid": os.getpid(),
    "born": born(os.getpid()),
    "host": host_name(),
    "namespace": pid_namespace(),
}

NO_PID = 2**22 + 1  # beyond all that Linux gives


@pytest.mark.parametrize(
    ("changes", "recent", "live"),
    [
        ({}, True, True),
        ({}, False, True),  # it stands still
        ({"loaded": False}, True, False),
        ({"born": 1}, False, False),  # its number is another process's now
        ({"pid": NO_PID}, True, False),
        ({"pid": NO_PID}, False, False),
        ({"host": "elsewhere"}, True, True),
        ({"host": "elsewhere"}, False, False),
        ({"host": "elsewhere", "pid": NO_PID}, True, True),
        ({"namespace": 1}, False, False),
        ({"namespace": 1, "pid": NO_PID}, True, True),
    ],
)
def test_who_is_live(changes: dict[str, Any], recent: bool, live: bool):
    ago_s = SILENT_S * (0.2 if recent else 1.1)
    status = MachineStatus("a", **{**ME, **changes})
    sample = Sample(status, 1, time.monotonic_ns() - round(ago_s * 1e9), ME["pid"])
    assert is_live(sample) is live


def test_a_process_is_told_from_a_later_one_of_its_number():
    assert born(os.getpid()) == born(os.getpid()) > 0
    assert born(NO_PID) == 0
    with subprocess.Popen(
        # A name with what separates fields, as anybody may choose it.
        [
            sys.executable,
            "-c",
            "from pathlib import Path; Path('/proc/self/comm').write_text('a) Z 1 (b'); input()",
        ],
        stdin=subprocess.PIPE,
    ) as process:
        assert process.stdin is not None
        comm = Path(f"/proc/{process.pid}/comm")
        wait_for(lambda: ") Z" in comm.read_text(), "not renamed")
        assert born(process.pid) >= born(os.getpid())
        process.kill()
        os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOWAIT)
        assert born(process.pid) == 0  # a zombie
