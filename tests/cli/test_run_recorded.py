"""`llfsm run --record`: whoever dies, the machines go on and the file is there."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest
from mcap.stream_reader import StreamReader

from llfsm.cli.run import world as recorded
from llfsm.machines import RosPingPong
from llfsm.runtime import Arrangement
from llfsm.runtime.journal.handover import Handover
from llfsm.runtime.plans import Plan
from llfsm.runtime.presence.live import LiveEnvironment
from llfsm.whiteboard import Whiteboard
from llfsm.whiteboard.liveness import this_process
from llfsm.whiteboard.messages.llfsm import RECORDER, Recorder
from small_disks import small_disk
from waiting import wait_for

from .conftest import Llfsm, alive, children, exists, wait_for_line

FILE = "run.mcap"


def events(file: Path) -> list[bytes]:
    found = []
    try:
        with file.open("rb") as stream:
            for record in StreamReader(stream).records:
                data = getattr(record, "data", b"")
                if isinstance(data, bytes) and data.startswith(b'{"event"'):
                    found.append(data)
    except Exception:  # a file that is not complete, yet or for ever
        pass
    return found


def start(llfsm: Llfsm, board: str) -> tuple[object, int]:
    """Start a machine that is recorded, and return when events are in the file."""
    process = llfsm.start("run", "RosPingPong", "-b", board, "--record", FILE)
    wait_for_line(process, "hello world")
    recorder = children(process.pid)["record"]
    wait_for(lambda: any(b"Turn" in each for each in events(llfsm.cwd / FILE)), "events")
    return process, recorder


def test_a_recorder_that_is_killed_does_not_stop_the_machines(llfsm: Llfsm, board: str) -> None:
    process, recorder = start(llfsm, board)
    os.kill(recorder, signal.SIGKILL)
    wait_for_line(process, "the recorder is gone: the machines go on unrecorded")
    wait_for_line(process, "hello world")
    wait_for_line(process, "hello world")
    process.terminate()
    printed = process.stdout.read()
    assert "the recorder" not in printed  # it is reported once
    assert process.wait() == 0


def test_a_full_disk_ends_the_recording_and_not_the_machines(llfsm: Llfsm, board: str) -> None:
    disk = llfsm.cwd / "disk"
    disk.mkdir()
    file = str(disk / FILE)
    with small_disk(disk, "24k"):
        process = llfsm.start("run", "RosPingPong", "-b", board, "--record", file)
        wait_for_line(process, "cannot be written: No space left on device")
        wait_for_line(process, "hello world")
        process.terminate()
        assert process.wait() == 0
        done = llfsm.run("rerun", file, "--trust")
        assert (done.returncode, "are as recorded" in done.stdout) == (0, True), done.stderr


def test_machines_that_are_killed_leave_a_complete_file(llfsm: Llfsm, board: str) -> None:
    process, recorder = start(llfsm, board)
    process.kill()
    wait_for(lambda: not alive(recorder), "the end of the recorder")
    data = (llfsm.cwd / FILE).read_bytes()
    assert data.endswith(data[:8])  # the magic, which only a complete file has at its end


def test_the_last_events_are_there(llfsm: Llfsm, board: str) -> None:
    process, recorder = start(llfsm, board)
    process.send_signal(signal.SIGINT)
    assert process.wait() == 0
    assert not alive(recorder)
    found = events(llfsm.cwd / FILE)
    assert b'"Loaded"' in found[0]
    assert b'"End"' in found[-1]


def test_a_recorder_that_stands_still_makes_nobody_wait(
    board: str,
    tmp_path: Path,
    caplog: pytest.LogCaptureFixture,
) -> None:
    with Whiteboard(board) as wb:
        options = {"limit": 1 << 20, "patience_s": 0.5}
        with recorded.recorded(tmp_path / FILE, wb, Plan(), **options) as environment:
            recorder = children(os.getpid())["record"]
            os.kill(recorder, signal.SIGSTOP)
            arrangement = Arrangement([RosPingPong], environment=environment)
            while "does not keep up" not in caplog.text:
                environment.journal.add(("Asked", "x" * 100_000, None))
                arrangement.round()
                environment.journal.flush()
            arrangement.end()
        assert not alive(recorder)
    assert len(caplog.records) == 1


def test_nothing_runs_if_nothing_can_be_recorded(llfsm: Llfsm, board: str) -> None:
    (llfsm.cwd / FILE).write_text("precious")
    done = llfsm.run_apart("run", "RosPingPong", "-q", "-b", board, "--record", FILE)
    assert done.returncode == 1
    assert done.stderr.splitlines() == [
        f"Error: {FILE} is there already: remove it, or record to another file",
        "Error: the recorder did not start, nothing was run",
    ]
    assert (llfsm.cwd / FILE).read_text() == "precious"
    assert done.stdout == ""


def test_runs_that_start_again_are_not_recorded(llfsm: Llfsm, board: str) -> None:
    done = llfsm.run("run", "RosPingPong", "-n", "-b", board, "--record", FILE)
    assert done.returncode == 2
    assert "--record keeps one run, -n may start several" in done.stderr
    assert not exists(board)


def test_machines_run_though_they_cannot_be_recorded(
    board: str, caplog: pytest.LogCaptureFixture
) -> None:
    with Whiteboard(board) as wb:
        recorder = Recorder(*this_process())
        wb.add_message(RECORDER, recorder)
        for _ in range(64):  # as many as a board has room for
            Handover(wb, recorder, whole=True)
        with recorded.recorded(None, wb, Plan()) as environment:
            assert isinstance(environment, LiveEnvironment)
        assert "the machines go on unrecorded: " in caplog.text
        with recorded.recorded(None, wb, Plan(), in_parts=True) as environment:
            assert isinstance(environment, LiveEnvironment)
