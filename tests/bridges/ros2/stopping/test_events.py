"""What stops the robot, and when: the rows of docs/how-to/safety.md, through to the topic.

Each event ends a machine that drives. What is posted, by which process, and that the robot does not
move again, holds at any speed of this machine. `make safety` prints the times and checks them.
"""

from __future__ import annotations

import signal
import subprocess
import time
from collections.abc import Callable
from typing import NamedTuple

import pytest

from llfsm.runtime.presence.remote import Directory
from llfsm.whiteboard.messages.llfsm import status_slot
from stopping_robot import report
from waiting import wait_for

from .conftest import Rig

SILENT_MS, WATCHDOG_MS = 500, 100
SILENT_S, WATCHDOG_S = SILENT_MS / 1e3, WATCHDOG_MS / 1e3
PATIENCE_S = 0.5
"""How long a hung run is waited for after a signal, before its safe values are posted."""
Machine = subprocess.Popen[str]


def cue(what: str) -> Callable[[Rig, Machine], None]:
    return lambda rig, _: rig.cue(what)


def send(number: signal.Signals) -> Callable[[Rig, Machine], None]:
    return lambda _, machine: machine.send_signal(number)


def suspend(rig: Rig, _: Machine) -> None:
    Directory(rig.board).find("Wheels").request("suspend")


class Row(NamedTuple):
    """A row of the table."""

    happens: Callable[[Rig, Machine], None]
    by: str
    lamp: str
    within_s: float
    options: tuple[str, ...] = ()
    after_s: float = 0.0
    """It must not be posted before."""


WATCHDOG = ("--watchdog", str(WATCHDOG_MS))
WILL_AFTER = ("--will-after", str(SILENT_MS))
SUSPEND = ("--on-error", "suspend")
GRACE_S, TURN_S, GUARD_S = 1.0, 0.1, 0.25
HUNG_S, DEAD_S = WATCHDOG_S + 0.05, SILENT_S + 0.3

ROWS = {
    "all machines accept": Row(cue("end"), "run", "ended", TURN_S),
    "Ctrl-C": Row(send(signal.SIGINT), "run", "ended", GRACE_S + TURN_S, (), GRACE_S),
    "SIGTERM": Row(send(signal.SIGTERM), "run", "ended", GRACE_S + TURN_S, (), GRACE_S),
    "suspended": Row(suspend, "run", "suspended", TURN_S),
    "code raises, the others go on": Row(cue("fail"), "run", "failed", TURN_S, SUSPEND),
    "code raises, all stop": Row(cue("fail"), "run", "ended", TURN_S),
    "SIGKILL": Row(send(signal.SIGKILL), "guard", "failed", GUARD_S),
    "crash": Row(cue("crash"), "guard", "failed", GUARD_S),
    "spins, watchdog": Row(cue("spin"), "run", "failed", HUNG_S, WATCHDOG, WATCHDOG_S),
    "sleeps, watchdog": Row(cue("sleep"), "run", "failed", HUNG_S, WATCHDOG, WATCHDOG_S),
    "spins, silent": Row(cue("spin"), "guard", "failed", DEAD_S, WILL_AFTER),
    "sleeps, silent": Row(cue("sleep"), "guard", "failed", DEAD_S, WILL_AFTER),
    "holds the interpreter, silent": Row(cue("hold"), "guard", "failed", DEAD_S, WILL_AFTER),
    "SIGSTOP, silent": Row(send(signal.SIGSTOP), "guard", "failed", DEAD_S, WILL_AFTER),
}


@pytest.mark.parametrize("name", ROWS)
def test_the_robot_stops(rig: Rig, name: str) -> None:
    row = ROWS[name]
    machine = rig.drive(*row.options)
    since_s = time.monotonic()
    row.happens(rig, machine)
    took_s = rig.robot.stopped_after(since_s)
    wait_for(lambda: rig.lamp == row.lamp, f"{row.lamp} is posted")
    by = {"run": machine.pid, "guard": rig.bridge}[row.by]
    assert rig.commander == by
    assert took_s >= row.after_s
    if row.options == WILL_AFTER:
        assert rig.silent_ms >= SILENT_MS
    machine.kill()
    machine.wait()
    stop_s = rig.robot.first_stop(since_s)
    if row.by == "guard":
        assert sum(each.time_s >= stop_s for each in rig.robot.got) == 1  # one command, once
    report(f"{rig.name:7} {name:31} {row.lamp:9} by the {row.by}", took_s, row.within_s)


in_memory = pytest.mark.parametrize("shared_rig", ["memory"], indirect=True)


def wait_for_silence(rig: Rig) -> None:
    """Wait until the process has published no status for twice as long as a guard would wait."""
    status = rig.board[status_slot("Wheels")]

    def silent_s() -> float:
        return (time.monotonic_ns() - status.sample().stamp_ns) / 1e9

    wait_for(lambda: silent_s() > 2 * SILENT_S, "the machine is silent")


@in_memory
@pytest.mark.parametrize("what", ["spin", "sleep"])
def test_a_hang_without_a_watchdog_stops_nothing_before_ctrl_c(rig: Rig, what: str) -> None:
    machine = rig.drive()
    rig.cue(what)
    wait_for_silence(rig)
    assert rig.robot.speed != 0
    assert rig.will == "left"
    since_s = time.monotonic()
    machine.send_signal(signal.SIGINT)
    took_s = rig.robot.stopped_after(since_s)
    wait_for(lambda: rig.lamp == "failed", "its safe values are posted")
    assert rig.commander == machine.pid
    assert took_s >= PATIENCE_S
    machine.send_signal(signal.SIGINT)
    machine.wait()
    assert rig.lamp == "ended"
    rig.robot.first_stop(since_s)
    report(f"memory  {what}s, Ctrl-C", took_s, PATIENCE_S + 0.1)


@in_memory
def test_a_stopped_process_stops_nothing_unless_asked(rig: Rig) -> None:
    machine = rig.drive()
    machine.send_signal(signal.SIGSTOP)
    wait_for_silence(rig)
    assert rig.robot.speed != 0
    assert rig.will == "left"


@in_memory
def test_a_watchdog_sees_a_call_that_holds_the_interpreter_only_afterwards(rig: Rig) -> None:
    machine = rig.drive("--watchdog", "1000")
    before = len(rig.robot.got)
    rig.cue("hold")
    wait_for_silence(rig)
    speed = rig.robot.speed
    wait_for(lambda: rig.robot.speed > speed, "it goes on")
    assert all(each.speed for each in rig.robot.got[before:])
    assert machine.stderr is not None
    line = machine.stderr.readline()
    assert line.startswith("this process has not run for ")
    assert "C code held the interpreter's lock" in line


@in_memory
def test_a_hang_that_a_watchdog_reports_is_no_silence(rig: Rig) -> None:
    rig.drive(*WATCHDOG, "--will-after", "1500")
    since_s = time.monotonic()
    rig.cue("sleep")
    rig.robot.stopped_after(since_s)
    status = rig.board[status_slot("Wheels")]
    count = status.count
    wait_for(lambda: status.count > count + 7, "it is published as hung for longer than that")
    assert status.get().hung
    assert rig.will == "left"
    rig.robot.first_stop(since_s)


@in_memory
def test_a_section_that_hangs_and_still_posts_replaces_its_safe_value(rig: Rig) -> None:
    machine = rig.drive(*WATCHDOG)
    rig.cue("post")
    wait_for(lambda: rig.lamp == "failed", "its safe values are posted")
    speed = max(each.speed for each in rig.robot.got)
    wait_for(lambda: rig.robot.speed > speed, "it drives on")
    since_s = time.monotonic()
    machine.kill()
    machine.wait()
    rig.robot.stopped_after(since_s)
