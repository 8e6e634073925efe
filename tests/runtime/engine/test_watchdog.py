"""Code of a machine that hangs is reported with its place, and the robot stops meanwhile."""

from __future__ import annotations

import logging
import os
import select
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from llfsm.runtime import Actuator, Arrangement, Machine, OptionError, Sensor, State
from llfsm.runtime.journal.entries import Journal, entries_of
from llfsm.runtime.journal.journalled import JournalledEnvironment
from llfsm.runtime.presence.live import LiveEnvironment
from llfsm.runtime.presence.remote import Directory
from llfsm.whiteboard import Slot, Whiteboard
from llfsm.whiteboard.messages.std_msgs import Int32
from waiting import wait_for

DRIVE, FREE = Slot("drive", Int32), Slot("free", Int32)
GO, SAFE, ENDED = (Int32(data=n) for n in (1, 2, 3))
THIS = Path(__file__).name


class Hangs(Machine):
    """Drive, and hang as `how` does until the slot `free` has a message."""

    drive = Actuator(DRIVE, at_failure=SAFE, at_end=ENDED)
    free = Sensor(FREE)
    how: Any = None
    in_guard: bool = False

    going = State()
    done = State()

    @going.on_entry
    def _(self) -> None:
        self.drive(GO)
        if not self.in_guard:
            self.how()  # hangs here

    @going.to(done)
    def freed(self) -> bool:
        if self.in_guard:
            self.how()
        return True


def spin(board: Whiteboard) -> None:
    while board.get_message(FREE) is None:
        pass


def sleep(board: Whiteboard) -> None:
    while board.get_message(FREE) is None:
        time.sleep(0.3)  # much longer than the limit


def wait(board: Whiteboard) -> None:
    board[FREE].wait(after=0)


def is_hung(board: Whiteboard) -> bool:
    return [m.condition for m in Directory(board).machines()] == ["hung"]


class Run:
    """An arrangement that runs in a thread of its own."""

    def __init__(self, board: Whiteboard, machine: Machine, **options: Any):
        self.arrangement = Arrangement([machine], whiteboard=board, **options)
        self.thread = threading.Thread(target=self.arrangement.run, daemon=True)

    def __enter__(self) -> Run:
        self.thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.arrangement.environment.whiteboard.add_message(FREE, Int32())
        self.thread.join()


@pytest.mark.parametrize("in_guard", [False, True])
@pytest.mark.parametrize("how", [spin, sleep, wait])
def test_it_is_reported_with_its_place_and_safe_values_are_posted(
    how: Callable[[Whiteboard], None], in_guard: bool, caplog: pytest.LogCaptureFixture
) -> None:
    board = Whiteboard.local()
    machine = Hangs(how=lambda: how(board), in_guard=in_guard)
    with Run(board, machine, watchdog_ms=30):
        wait_for(lambda: board.get_message(DRIVE) == SAFE)
        wait_for(lambda: is_hung(board))
        status = Directory(board).find("Hangs").status
        step = "transition freed" if in_guard else "OnEntry"
        assert f"machine Hangs, state going, {step} (" in status.error
        assert THIS in status.error
        assert status.state == "going"
    assert board.get_message(DRIVE) == ENDED
    reports = [r.getMessage() for r in caplog.records]
    assert sum("has been running for" in text for text in reports) == 1
    assert sum("has returned after" in text for text in reports) == 1


def test_it_goes_on_when_the_section_returns() -> None:
    board = Whiteboard.local()
    machine = Hangs(how=lambda: wait(board))
    with Run(board, machine, watchdog_ms=30, unload_accepting=False) as run:
        wait_for(lambda: is_hung(board))
        board.add_message(FREE, Int32())
        wait_for(lambda: machine.state_name == "done")
        run.arrangement.stop()
    assert run.arrangement.roster.find("Hangs").hang == ""


class Quick(Machine):
    turns: int = 0
    a = State()
    b = State()

    @a.internal
    def _(self) -> None:
        self.turns += 1

    a.to(b, when=lambda m: m.turns > 3000)


STOPPED = """
import logging
from llfsm.runtime import Arrangement, Machine, State

class Waits(Machine):
    a, b = State(), State()
    a.to(b, when=lambda m: False)
    a.on_entry(lambda m: print("runs", flush=True))

logging.basicConfig()
Arrangement([Waits], watchdog_ms=20).run()
"""


def test_a_process_that_was_stopped_reports_it_when_it_goes_on() -> None:
    command = [sys.executable, "-c", STOPPED]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "runs\n"
        process.send_signal(signal.SIGSTOP)
        until = time.monotonic() + 1.5
        wait_for(lambda: time.monotonic() > until)
        process.send_signal(signal.SIGCONT)
        wait_for(lambda: select.select([process.stderr], [], [], 0)[0], patience_s=20)
        process.terminate()
        assert "this process has not run for" in process.communicate()[1]


def test_a_machine_that_is_merely_busy_is_not_reported(caplog: pytest.LogCaptureFixture) -> None:
    Arrangement([Quick], idle_us=0, watchdog_ms=20).run()
    assert not caplog.records


def test_a_journal_keeps_nothing_of_what_a_watchdog_posts() -> None:
    board, written = Whiteboard.local(), []
    environment = JournalledEnvironment(LiveEnvironment(board), Journal(written.append))
    machine = Hangs(how=lambda: wait(board))
    arrangement = Arrangement([machine], environment=environment, watchdog_ms=30)
    thread = threading.Thread(target=arrangement.run, daemon=True)
    thread.start()
    wait_for(lambda: is_hung(board))
    board.add_message(FREE, Int32())
    thread.join()
    entries = [entry for data in written for entry in entries_of(data)]
    posted = [DRIVE.decoder.decode(e["message"]) for e in entries if e["event"] == "Posted"]
    assert posted == [GO, ENDED]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_the_first_signal_says_where_it_hangs_and_stops_the_robot(
    number: signal.Signals, caplog: pytest.LogCaptureFixture
) -> None:
    board = Whiteboard.local()

    def free_when_reported() -> None:
        wait_for(lambda: board.get_message(DRIVE) is not None)
        os.kill(os.getpid(), number)
        wait_for(lambda: "a second signal interrupts it" in caplog.text)
        board.add_message(FREE, Int32())

    helper = threading.Thread(target=free_when_reported, daemon=True)
    helper.start()
    machine = Hangs(how=lambda: spin(board))
    Arrangement([machine], whiteboard=board).run()
    helper.join()
    assert f"machine Hangs, state going, OnEntry ({__file__}:" in caplog.text
    assert board[DRIVE].count == 3  # go, safe, ended


def test_an_impossible_limit_is_refused() -> None:
    with pytest.raises(OptionError, match="watchdog_ms is 0; it must be 1 or more"):
        Arrangement(watchdog_ms=0)


def test_a_section_that_hangs_in_its_log_keeps_no_safe_value_back() -> None:
    board = Whiteboard.local()
    log = logging.getLogger("llfsm.runtime")

    class Stuck(logging.Handler):  # it holds its lock meanwhile
        def emit(self, record: logging.LogRecord) -> None:
            board[FREE].wait(after=0)

    handler = Stuck()
    log.addHandler(handler)
    try:
        machine = Hangs(how=lambda: log.error("stuck"))
        with Run(board, machine, watchdog_ms=30):
            wait_for(lambda: board.get_message(DRIVE) == SAFE, "the robot stops")
    finally:
        log.removeHandler(handler)


def test_the_hang_of_a_machine_that_has_left_meanwhile_is_not_published() -> None:
    board = Whiteboard.local()
    arrangement = Arrangement([Quick], whiteboard=board)
    attendant = arrangement.environment.attend(arrangement)
    assert attendant is not None
    arrangement.unload("Quick")
    attendant.publish_hang("Quick")
    assert not is_hung(board)
