"""A recorder, machines, and who asks for them, each in a PID namespace of its own."""

from __future__ import annotations

from pathlib import Path

import pytest

from containers import UNSHARE, needs_containers
from llfsm.bridges.recording.reader import Recording
from llfsm.bridges.recording.recorders import JournalRecorder
from llfsm.bridges.recording.writer import RecordingWriter
from llfsm.runtime.journal import handover
from llfsm.runtime.journal.handover import Handover, find_recorder
from llfsm.whiteboard import Whiteboard
from llfsm.whiteboard.liveness import host_name, pid_namespace
from llfsm.whiteboard.messages.llfsm import RECORDER, Recorder
from waiting import wait_for

from .conftest import Start, end_of, entries_in

CONTAINED = 1, 1, host_name(), pid_namespace() + 1


@pytest.fixture
def contained(board: Whiteboard, llfsm: Start) -> Start:
    """Start `llfsm` processes for the board, each in a PID namespace of its own."""
    return lambda *arguments: llfsm(*arguments, "-b", board.name, within=UNSHARE)


@needs_containers
def test_a_recorder_in_another_container_records_and_is_not_replaced(
    board: Whiteboard, file: Path, contained: Start
) -> None:
    recorder = contained("record", "-o", file.name, "--until-eof")
    wait_for(lambda: find_recorder(board), "the recorder")
    contained("run", "RosPingPong", "-q")
    wait_for(lambda: len(entries_in(Recording(file))) > 20, "its events")
    found = find_recorder(board)
    assert found is not None
    mine = Handover(board, found, whole=True)  # not on the slot of the other journal
    with RecordingWriter(file.with_name("other.mcap"), {}) as writer:
        other = JournalRecorder(board, writer).other
        assert other == "process 1 in another PID namespace"
        assert mine.works
        assert recorder.stdin is not None
        recorder.stdin.close()
        assert end_of(recorder)[0] == 0
        assert len(Recording(file).journals) == 2
        assert find_recorder(board) is None
        mine.go_on()
        assert not mine.works
        third = JournalRecorder(board, writer)
        assert not third.other
        third.close()


def test_a_recorder_without_anything_to_record_posts_signs_of_life(
    board: Whiteboard, file: Path
) -> None:
    with RecordingWriter(file, {}) as writer:
        receiver = JournalRecorder(board, writer)
        count = board[RECORDER].count
        wait_for(lambda: board[RECORDER].count > count, "a sign of life", between=receiver.poll)
        receiver.close()


def test_a_recorder_that_was_held_up_leaves_the_machines_to_the_one_that_has_replaced_it(
    board: Whiteboard, file: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with RecordingWriter(file, {}) as writer:
        receiver = JournalRecorder(board, writer)
        board.add_message(RECORDER, Recorder(*CONTAINED))
        count = board[RECORDER].count
        reported = "another process records the machines now"
        wait_for(lambda: reported in caplog.text, "it notices", between=receiver.poll)
        receiver.poll()
        receiver.close()
        assert board[RECORDER].count == count


def test_a_recorder_in_another_container_that_is_silent_is_replaced(
    board: Whiteboard, file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    board.add_message(RECORDER, Recorder(*CONTAINED))
    with RecordingWriter(file, {}) as writer:
        assert JournalRecorder(board, writer).other == "process 1 in another PID namespace"
        monkeypatch.setattr(handover, "SILENT_S", 0.0)
        receiver = JournalRecorder(board, writer)
        assert not receiver.other
        receiver.close()
