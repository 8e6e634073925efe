"""From a board into a file, which can be read whichever process is killed."""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from llfsm.bridges.recording.reader import Recording
from llfsm.bridges.recording.recorders import BoardRecorder, record
from llfsm.bridges.recording.writer import RecordingWriter
from llfsm.whiteboard import BoardNotFoundError, Whiteboard
from llfsm.whiteboard.messages.llfsm import VIEWER
from waiting import PATIENCE_S, wait_for

from .conftest import OTHER, READING, Reading, end_of

OWN = VIEWER.name


def numbers(file: Path, slot: str = READING.name) -> list[int]:
    recording = Recording(file)
    return [each.sample(m).message.number for each, m in recording.messages([slot])]


def start(llfsm: Any, board: Whiteboard, *arguments: object) -> Any:
    """Start a recorder and return when it has the board."""
    process = llfsm("record", "-o", "run.mcap", "-b", board.name, *arguments)
    assert process.stdout.readline() == f"recording the whiteboard '{board.name}' to run.mcap\n"
    return process


def post(board: Whiteboard, file: Path, number: int) -> None:
    """Add a message, and return when it can be read in the file."""
    board.add_message(READING, Reading(number))
    wait_for(lambda: number in numbers(file), f"{number} in the file")


def test_each_poll_writes_what_is_new(board: Whiteboard, file: Path) -> None:
    board.add_message(READING, Reading(1))
    with RecordingWriter(file, {}) as writer:
        recorder = BoardRecorder(board, writer, ["robot/*"])
        for number in range(2, 6):
            recorder.poll()
            recorder.poll()
            board.add_message(READING, Reading(number))
        board.add_message(READING, Reading(6))  # which replaces 5 before the poll
        recorder.poll()
        assert writer.missed() == {READING.name: 1}
    assert numbers(file) == [1, 2, 3, 4, 6]


def test_a_stamp_that_no_clock_has_shown_yet_is_the_present(board: Whiteboard, file: Path) -> None:
    """Another process has damaged it: then the recording is as long as it was."""
    board.add_message(READING, Reading(1))
    stamp_ns = board[READING].sample().stamp_ns
    data = board.path.read_bytes()
    at = data.index(stamp_ns.to_bytes(8, "little"))
    with board.path.open("r+b") as damaged:
        damaged.seek(at)
        damaged.write((2**64 - 1).to_bytes(8, "little"))
    with RecordingWriter(file, {}) as writer:
        BoardRecorder(board, writer, ["robot/*"]).poll()
    begin_ns, end_ns = Recording(file).span_ns
    assert end_ns - begin_ns < PATIENCE_S * 1e9
    assert numbers(file) == [1]


def test_it_asks_for_variables_if_they_are_recorded(board: Whiteboard, tmp_path: Path) -> None:
    with RecordingWriter(tmp_path / "a.mcap", {}) as writer:
        BoardRecorder(board, writer, ["robot/*"]).poll()
        assert board[VIEWER].count == 0
        BoardRecorder(board, writer).poll()
    assert board.get_message(VIEWER).pid == os.getpid()


def test_a_slot_that_cannot_be_read_is_one_warning_and_left_out(
    board: Whiteboard, file: Path, caplog: pytest.LogCaptureFixture, monkeypatch: Any
) -> None:
    board.add_message(READING, Reading(1))
    board.add_message(OTHER, Reading(2))
    infos = board.slots()
    bad = [infos[0]._replace(schema={"title": "Bad", "type": "object", "properties": {"a": {}}})]
    monkeypatch.setattr(board, "slots", lambda: bad + infos[1:])
    with RecordingWriter(file, {}) as writer:
        recorder = BoardRecorder(board, writer, ["robot/*"])
        recorder.poll(last=True)
        recorder.poll(last=True)
    assert len(caplog.records) == 1
    assert READING.name in caplog.text
    assert numbers(file, OTHER.name) == [2]


def test_a_slow_writer_is_recorded_without_a_gap(board: Whiteboard, file: Path) -> None:
    over = threading.Event()
    board.add_message(READING, Reading(-1))
    with RecordingWriter(file, {}) as writer:
        recorder = BoardRecorder(board, writer, ["robot/reading"])
        thread = threading.Thread(target=record, args=(recorder, None, writer, over.is_set))
        thread.start()
        for number in range(50):
            board.add_message(READING, Reading(number))
            wait_for(lambda number=number: writer.messages > number + 1, f"message {number}")
        over.set()
        thread.join()
    assert numbers(file) == list(range(-1, 50))


def test_the_last_messages_before_the_end_are_there(board: Whiteboard, file: Path) -> None:
    board.add_message(READING, Reading(1))
    with RecordingWriter(file, {}) as writer:
        recorder = BoardRecorder(board, writer)
        board.add_message(READING, Reading(2))
        record(recorder, None, writer, lambda: True)
    assert numbers(file) == [2]


def test_what_is_a_second_old_is_in_the_file(board: Whiteboard, file: Path) -> None:
    """A process that is killed then has lost no more than that second."""
    with RecordingWriter(file, {}) as writer:
        board.add_message(READING, Reading(1))
        BoardRecorder(board, writer, ["robot/*"]).poll()
        until_ns = time.monotonic_ns() + 1_000_000_000
        wait_for(lambda: time.monotonic_ns() > until_ns)
        writer.flush_if_due()
        assert numbers(file) == [1]


def test_killed_it_leaves_a_file_that_can_be_read(
    llfsm: Any, board: Whiteboard, file: Path
) -> None:
    process = start(llfsm, board)
    for number in range(1, 4):
        post(board, file, number)
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert numbers(file) == [1, 2, 3]
    assert not Recording(file).complete


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_completes_the_file(
    llfsm: Any, board: Whiteboard, file: Path, number: signal.Signals
) -> None:
    process = start(llfsm, board)
    board.add_message(READING, Reading(7))
    process.send_signal(number)
    status, printed = end_of(process)
    assert status == 0
    assert printed.startswith("run.mcap: ")
    assert Recording(file).complete
    assert numbers(file) == [7]


def test_any_number_of_interrupts_completes_the_file(
    llfsm: Any, board: Whiteboard, file: Path
) -> None:
    process = start(llfsm, board)
    board.add_message(READING, Reading(7))
    for _ in range(round(PATIENCE_S / 0.0005)):
        process.send_signal(signal.SIGINT)
        with suppress(subprocess.TimeoutExpired):
            process.wait(0.0005)
            break
    status, printed = end_of(process)
    assert status == 0
    assert printed.startswith("run.mcap: ")
    assert Recording(file).complete
    assert numbers(file) == [7]


def test_the_end_of_the_board_is_the_end(llfsm: Any, board: Whiteboard, file: Path) -> None:
    process = start(llfsm, board, "--slots", "robot/*")
    board.add_message(READING, Reading(6))
    board.add_message(READING, Reading(7))
    board.remove()
    status, printed = end_of(process)
    assert status == 0
    assert printed in (  # without a poll between the two
        "run.mcap: 2 messages recorded, 0 missed\n",
        "run.mcap: 1 messages recorded, 1 missed\n",
    )
    assert numbers(file)[-1] == 7
    assert Recording(file).complete


def test_it_ends_after_a_time(llfsm: Any, board: Whiteboard, file: Path) -> None:
    assert end_of(start(llfsm, board, "--max-time", 0.1))[0] == 0
    assert Recording(file).complete


def test_it_ends_at_a_size(llfsm: Any, board: Whiteboard, file: Path) -> None:
    process = start(llfsm, board, "--max-size", 0.05)
    while process.poll() is None:
        board.add_message(READING, Reading(data=os.urandom(500)))
    assert process.returncode == 0
    assert Recording(file).complete
    assert 50_000 <= file.stat().st_size < 50_000 + 3_000_000  # a second's chunk more


def test_only_slots_that_match(llfsm: Any, board: Whiteboard, file: Path) -> None:
    board.add_message(READING, Reading())
    board.add_message(OTHER, Reading())
    end_of(start(llfsm, board, "--slots", "*/other", "--slots", "x", "--max-time", 0.1))
    assert [*Recording(file).slots] == [OTHER.name]


def test_a_full_disk_ends_it_and_what_was_written_can_be_read(
    llfsm: Any, board: Whiteboard, file: Path
) -> None:
    def small() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (30_000, 30_000))

    process = llfsm("record", "-o", "run.mcap", "-b", board.name, preexec_fn=small)
    assert "only slots are recorded" in process.stdout.readline()
    process.stdout.readline()
    assert "llfsm/variables/" in process.stdout.readline()  # it cannot ask for those either
    while process.poll() is None:
        board.add_message(READING, Reading(data=os.urandom(500)))
    status, printed = end_of(process)
    assert (status, printed) == (1, "Error: run.mcap: cannot be written: File too large\n")
    assert Recording(file).about["board"] == board.name


@pytest.mark.parametrize(
    ("arguments", "status", "why"),
    [
        (["-o", "run.mcap", "-b", "../x"], 1, "'../x' is not a valid whiteboard name"),
        (["-o", "no/run.mcap"], 1, "no/run.mcap: cannot be written: No such file or directory"),
        ([], 2, "Missing option '-o'"),
    ],
)
def test_wrong_use_is_one_line(
    llfsm_here: Any, board: Whiteboard, arguments: list[str], status: int, why: str
) -> None:
    on = [] if "-b" in arguments else ["-b", board.name]
    found, printed = llfsm_here("record", *arguments, *on)
    assert (found, printed.count("Error: ")) == (status, 1)
    assert why in printed


def test_a_file_is_never_overwritten(llfsm_here: Any, board: Whiteboard, file: Path) -> None:
    file.write_text("precious")
    status, printed = llfsm_here("record", "-o", "run.mcap", "-b", board.name)
    assert (status, file.read_text()) == (1, "precious")
    assert "run.mcap is there already" in printed


def test_neither_is_a_file_made_of_a_host_that_cannot_be_reached(
    llfsm_here: Any, board: Whiteboard, file: Path
) -> None:
    status, printed = llfsm_here("record", "-o", "run.mcap", "--host", "robot7", "-b", board.name)
    assert (status, "no daemon mirrors this whiteboard" in printed) == (1, True)
    assert not file.exists()
    assert llfsm_here("record", "-o", "run.mcap", "--host", "robot7", "-b", "none")[0] == 1
    with pytest.raises(BoardNotFoundError):
        Whiteboard("none", create=False)


def test_a_board_is_not_made_for_a_file_that_cannot_be(llfsm_here: Any, file: Path) -> None:
    file.write_text("precious")
    name = f"test-vain-{os.getpid()}"
    assert llfsm_here("record", "-o", "run.mcap", "-b", name)[0] == 1
    with pytest.raises(BoardNotFoundError):
        Whiteboard(name, create=False)


def test_a_board_that_was_there_stays_when_the_file_cannot_be(
    llfsm_here: Any, board: Whiteboard, file: Path
) -> None:
    file.write_text("precious")
    assert llfsm_here("record", "-o", "run.mcap", "-b", board.name)[0] == 1
    assert board.alive
