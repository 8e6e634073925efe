"""A recorder that was started by itself has the events of machines, too."""

from __future__ import annotations

import os
import signal
from contextlib import suppress
from pathlib import Path
from typing import Any

import msgspec
import pytest
from mcap.exceptions import EndOfFile
from mcap.records import Attachment, Metadata
from mcap.stream_reader import StreamReader

from llfsm.bridges.recording.reader import Recording
from llfsm.bridges.recording.recorders import BoardRecorder, JournalRecorder, record
from llfsm.bridges.recording.rerun import Rerun, whole_journals
from llfsm.bridges.recording.writer import ARRANGEMENT, RecordingWriter
from llfsm.runtime import Arrangement, Machine, ManualClock, State
from llfsm.runtime.journal.handover import Handover, find_recorder
from llfsm.runtime.journal.journalled import JournalledEnvironment
from llfsm.runtime.presence.live import LiveEnvironment
from llfsm.whiteboard import BoardFullError, BoundSlot, Slot, Whiteboard
from llfsm.whiteboard.board_files import remove_board
from llfsm.whiteboard.liveness import host_name, pid_namespace, this_process
from llfsm.whiteboard.message import M
from llfsm.whiteboard.messages.llfsm import RECORDER, JournalPart, Recorder, journal_slot
from waiting import wait_for

from .conftest import end_of, entries_in

MS = 1_000_000


class Blink(Machine):
    on = State()
    off = State()
    on.to(off, after_ms=20)
    off.to(on, after_ms=20)


def start(llfsm: Any, board: Whiteboard, *arguments: object) -> Any:
    process = llfsm("record", "-o", "run.mcap", "-b", board.name, *arguments)
    assert process.stdout.readline().startswith("recording the whiteboard")
    return process


def has_events(file: Path, kind: str, number: int = 1) -> bool:
    return sum(entry["event"] == kind for entry in entries_in(Recording(file))) >= number


def run(llfsm: Any, board: Whiteboard, *arguments: object) -> Any:
    return llfsm("run", *arguments, "-q", "-b", board.name)


def end(process: Any) -> str:
    process.send_signal(signal.SIGINT)
    status, printed = end_of(process)
    assert status == 0, printed
    return printed


def test_it_may_be_there_before_the_board(
    llfsm: Any, llfsm_here: Any, board: Whiteboard, file: Path
) -> None:
    board.remove()
    recorder = start(llfsm, board)
    machine = run(llfsm, board, "RosPingPong")
    wait_for(lambda: has_events(file, "Turn", 5), "events")
    end(machine)
    assert "running before" not in end(recorder)
    remove_board(board.name)
    assert llfsm_here("rerun", file, "--trust")[0] == 0


def test_machines_that_start_later_run_again(
    llfsm: Any, llfsm_here: Any, board: Whiteboard, file: Path
) -> None:
    recorder = start(llfsm, board)
    both = ["RosPingPong", "TurtleSuspendResume"]
    first = run(llfsm, board, *both, "TurtleSuspendResume:target=RosPingPong")
    wait_for(lambda: has_events(file, "Turn", 20), "events")
    second = run(llfsm, board, "a=RosPingPong")
    wait_for(lambda: len(Recording(file).journals) == 2, "a second journal")
    end(first)
    end(second)
    third = run(llfsm, board, "RosPingPong")  # as often as they are started
    wait_for(lambda: len(Recording(file).journals) == 3, "a third journal")
    end(third)
    printed = end(recorder)
    assert " events of machines" in printed
    assert "running before" not in printed
    journals = whole_journals(Recording(file))
    assert [journal.about["machines"] for journal in journals] == [
        "RosPingPong, TurtleSuspendResume",
        "a",
        "RosPingPong",
    ]
    assert sum(entry["event"] == "End" for entry in entries_in(Recording(file))) == 3
    status, printed = llfsm_here("rerun", file, "--trust")
    assert (status, printed.split()[-3:]) == (0, ["are", "as", "recorded"])
    status, printed = llfsm_here("rerun", file, "RosPingPong")
    assert status == 2
    assert "has these machines: RosPingPong, TurtleSuspendResume, a, RosPingPong" in printed
    others = ["RosPingPong", "TurtleSuspendResume", "RosWallTurttleBot", "RosPingPong"]
    status, printed = llfsm_here("rerun", file, *others)
    assert (status, printed.count(" differs, after ")) == (1, 1)


def test_of_machines_that_ran_before_the_events_are_there_and_it_says_what_is_missing(
    llfsm: Any, llfsm_here: Any, board: Whiteboard, file: Path
) -> None:
    machine = run(llfsm, board, "RosPingPong")
    board_has_events(board)
    recorder = start(llfsm, board)
    wait_for(lambda: has_events(file, "RoundEnd", 20), "events")
    printed = end(recorder)
    assert f"RosPingPong (process {machine.pid}) was running before the recording: its" in printed
    (journal,) = Recording(file).journals
    assert not journal.whole
    status, printed = llfsm_here("rerun", file, "--trust")
    assert (status, printed.count("\n")) == (1, 1)
    assert f"RosPingPong (process {machine.pid}) ran before they were recorded, so what" in printed
    again = llfsm("record", "-o", "again.mcap", "-b", board.name)  # and another one, later
    wait_for(lambda: find_recorder(board) is not None, "a recorder")
    wait_for(lambda: (file.with_name("again.mcap")).exists(), "its file")
    wait_for(lambda: has_events(file.with_name("again.mcap"), "RoundEnd", 5), "events")
    end(again)
    end(machine)


def board_has_events(board: Whiteboard) -> None:
    wait_for(lambda: "llfsm/recorder" in {info.name for info in board.slots()}, "the machine")


def test_one_process_at_a_time_records_the_machines(
    llfsm: Any, llfsm_here: Any, board: Whiteboard, file: Path
) -> None:
    first = start(llfsm, board)
    second = llfsm("record", "-o", "other.mcap", "-b", board.name, "--max-time", 0.1)
    status, printed = end_of(second)
    assert status == 0
    assert f"process {first.pid} records the machines already, this one only slots" in printed
    status, printed = llfsm_here("run", "RosPingPong", "-b", board.name, "--record", "x.mcap")
    assert status == 1
    assert f"process {first.pid} records the machines of {board.name!r} already" in printed
    assert not file.with_name("x.mcap").exists()
    first.kill()
    first.wait()
    third = llfsm("record", "-o", "third.mcap", "-b", board.name, "--max-time", 0.1)
    assert "already" not in end_of(third)[1]


def test_events_are_left_out_unless_they_match(llfsm: Any, board: Whiteboard) -> None:
    recorder = start(llfsm, board, "--slots", "robot/*")
    assert find_recorder(board) is None
    end(recorder)
    recorder = llfsm("record", "-o", "b.mcap", "-b", board.name, "--slots", "llfsm/events")
    wait_for(lambda: find_recorder(board) is not None, "a recorder")
    end(recorder)
    assert find_recorder(board) is None


def test_machines_that_are_killed_leave_all_that_was_handed_over(
    llfsm: Any, llfsm_here: Any, board: Whiteboard, file: Path
) -> None:
    recorder = start(llfsm, board)
    machine = run(llfsm, board, "RosPingPong")
    wait_for(lambda: has_events(file, "Turn", 20), "events")
    machine.kill()
    machine.wait()
    board.remove()
    assert end_of(recorder)[0] == 0  # though that journal never ended
    assert Recording(file).complete
    status, printed = llfsm_here("rerun", file, "--trust")
    assert (status, printed.split()[-3:]) == (0, ["are", "as", "recorded"])


def arrange(board: Whiteboard, clock: ManualClock, **options: int) -> Arrangement:
    recorder = find_recorder(board)
    assert recorder is not None
    handover = Handover(board, recorder, whole=True, **options)
    live = LiveEnvironment(board, clock, handover=handover)
    return Arrangement([Blink], environment=JournalledEnvironment(live, handover.journal))


def test_all_that_begin_between_two_polls_are_recorded(board: Whiteboard, file: Path) -> None:
    clock = ManualClock()
    with RecordingWriter(file, {}) as writer:
        receiver = JournalRecorder(board, writer)
        arrangements = [arrange(board, clock) for _ in range(3)]
        for _ in range(10):
            receiver.poll()
            clock.advance(ms=30)
            for arrangement in arrangements:
                arrangement.round()
        receiver.close()
    recording = Recording(file)
    for journal in recording.journals:
        assert sum(entry["event"] == "Turn" for entry in recording.entries(journal)) >= 5
    assert len(recording.journals) == 3


def test_what_was_lost_is_in_the_file_and_ends_the_comparison(
    board: Whiteboard, file: Path
) -> None:
    clock = ManualClock()
    with RecordingWriter(file, {}) as writer:
        receiver = JournalRecorder(board, writer)
        arrangement = arrange(board, clock, limit=2_000)
        for number in range(100):
            clock.advance(ms=11)
            arrangement.round()
            if number < 20 or number > 40:  # between these more comes than is kept
                receiver.poll()
        receiver.poll()
        assert receiver.journals == 1
        assert writer.lost == 1
        receiver.close()
    recording = Recording(file)
    kinds = [entry["event"] for entry in entries_in(recording)]
    assert kinds.count("Lost") == 1
    before = sum(k in ("Turn", "RoundBegin") for k in kinds[: kinds.index("Lost")])
    assert before > 20
    again = Rerun(recording.entries(recording.journals[0]))
    again.arrange([Blink])
    assert again.compare() is None
    assert again.lost
    assert again.events == sum("reads" in e for e in entries_up_to_lost(recording))


def entries_up_to_lost(recording: Recording) -> list[dict[str, Any]]:
    entries = entries_in(recording)
    return entries[: next(i for i, e in enumerate(entries) if e["event"] == "Lost")]


GARBAGE = [
    b"\x04\x00\x00\x00abcd",
    (5).to_bytes(4, "little") + msgspec.msgpack.encode([["x"]]) + b"??",
    (12).to_bytes(4, "little") + msgspec.msgpack.encode([["Dreamt", 1]])[:12].ljust(12, b"\0"),
    b"\xff\xff\xff\xff" * 9,
    len(FAR := msgspec.msgpack.encode([["RoundBegin", [], 1, 2**64 - 1]])).to_bytes(4, "little")
    + FAR,
    len(PAST := msgspec.msgpack.encode([["RoundBegin", [], 1, -(2**62)]])).to_bytes(4, "little")
    + PAST,
]


@pytest.mark.parametrize("data", GARBAGE)
def test_an_invalid_journal_is_one_warning_and_the_others_go_on(
    board: Whiteboard, file: Path, data: bytes, caplog: pytest.LogCaptureFixture
) -> None:
    clock = ManualClock()
    with RecordingWriter(file, {}) as writer:
        bad = [board[journal_slot(number)] for number in range(8)][-1]
        receiver = JournalRecorder(board, writer)
        arrangement = arrange(board, clock)
        receiver.poll()
        bad.add(JournalPart(*this_process(), 1, True, 0))
        receiver.poll()
        bad.add(JournalPart(*this_process(), 1, True, 1, data=data))
        for _ in range(10):
            clock.advance(ms=30)
            arrangement.round()
            receiver.poll()
        receiver.close()
    recording = Recording(file)
    good = next(j for j in recording.journals if j.about.get("machines") == "Blink")
    assert sum(e["event"] == "Turn" for e in recording.entries(good)) >= 8
    assert caplog.text.count("writes an invalid journal") == 1


def test_parts_meant_for_an_earlier_recorder_are_left_out(board: Whiteboard, file: Path) -> None:
    slot = board[journal_slot(0)]
    slot.add(JournalPart(*this_process(), 5, True, 0))
    with RecordingWriter(file, {}) as writer:
        receiver = JournalRecorder(board, writer)
        slot.add(JournalPart(*this_process(), 5, True, 1, data=b"????"))
        receiver.poll()
        recorder = find_recorder(board)
        assert recorder is not None
        assert recorder.taken[0] == 2
        assert not receiver.journals
        receiver.close()
    assert board.get_message(journal_slot(0)).data == b"????"
    assert find_recorder(board) is None


def test_arrangements_and_definitions_are_metadata_and_attachments(
    llfsm: Any, board: Whiteboard, file: Path
) -> None:
    recorder = start(llfsm, board)
    machine = run(llfsm, board, "a=RosPingPong")
    wait_for(lambda: has_events(file, "Turn", 5), "events")
    wait_for(lambda: b"llfsm/definition/a" in file.read_bytes(), "the definition")
    recorder.kill()  # as soon as they are known they are there
    recorder.wait()
    end(machine)
    found: dict[str, Any] = {}
    with file.open("rb") as stream, suppress(EndOfFile):
        for record in StreamReader(stream).records:
            if isinstance(record, Metadata | Attachment):
                found[record.name] = record
    about = found[ARRANGEMENT].metadata
    assert (about["machines"], about["whole"]) == ("a", "yes")
    assert msgspec.json.decode(about["plan"])["machine"][0]["definition"] == "RosPingPong"
    definition = msgspec.json.decode(found["llfsm/definition/a"].data)
    assert [state["name"] for state in definition["states"]][:1] == ["INITIAL"]
    recording = Recording(file)
    assert "llfsm/definition/a" in recording.slots
    assert not any("journal" in name or "recorder" in name for name in recording.slots)


def test_an_old_recorder_is_replaced(board: Whiteboard, file: Path) -> None:
    here = host_name(), pid_namespace()
    board.add_message(journal_slot(0), JournalPart(1, 2, *here, 3, True, 0))
    board.add_message(
        RECORDER, Recorder(os.getpid(), 1, *here)
    )  # a process of that number has died
    with RecordingWriter(file, {}) as writer:
        receiver = JournalRecorder(board, writer)
        assert not receiver.other
        assert JournalRecorder(board, writer).other == f"process {os.getpid()}"
        receiver.close()


def test_it_waits_for_the_machines_of_a_board_that_is_gone_but_not_for_ever(
    board: Whiteboard, file: Path
) -> None:
    with RecordingWriter(file, {}) as writer:
        receiver = JournalRecorder(board, writer)
        clock = ManualClock()
        arrangement = arrange(board, clock)  # which will never end

        def is_over() -> bool:
            if receiver.journals == 0:
                arrangement.round()
            elif board.path.exists():
                board.path.unlink()
            return False

        record(BoardRecorder(board, writer), receiver, writer, is_over, patience_s=0.2)
        assert receiver.journals == 1
        assert not receiver.idle
        receiver.close()


class NoRoom(Whiteboard):
    """A board with room for one journal's slot."""

    def publisher(self, slot: Slot[M]) -> BoundSlot[M]:
        if slot.name == journal_slot(1).name:
            raise BoardFullError("no room")
        return super().publisher(slot)


def test_a_board_without_room_for_more_is_one_warning(
    board: Whiteboard, file: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with NoRoom(board.name) as full, RecordingWriter(file, {}) as writer:
        receiver = JournalRecorder(full, writer)
        clock = ManualClock()
        arrangement = arrange(board, clock)
        for _ in range(5):
            clock.advance(ms=30)
            arrangement.round()
            receiver.poll()
        receiver.close()
    assert caplog.text.count("no more machines can be recorded: no room") == 1
    assert has_events(file, "Turn", 3)
