"""A journal comes to the recorder as it was written, and nobody waits for that."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from llfsm.runtime import Actuator, Arrangement, Machine, ManualClock, Sensor, State
from llfsm.runtime.journal import handover as module
from llfsm.runtime.journal.entries import entries_of
from llfsm.runtime.journal.handover import Handover, find_recorder
from llfsm.runtime.journal.journalled import JournalledEnvironment
from llfsm.runtime.presence.live import LiveEnvironment
from llfsm.runtime.presence.status_publisher import StatusPublisher
from llfsm.whiteboard import Board, BoardFullError, Slot, Whiteboard
from llfsm.whiteboard.liveness import born, host_name, pid_namespace
from llfsm.whiteboard.messages.llfsm import (
    JOURNALS,
    RECORDER,
    JournalPart,
    Recorder,
    journal_slot,
)
from llfsm.whiteboard.messages.std_msgs import Int32
from thoroughness import examples
from waiting import wait_for

NUMBER = Slot("number", Int32)
SEEN = Slot("seen", Int32)
SLOT = journal_slot(0).capacity


class Echo(Machine):
    number = Sensor(NUMBER, default=Int32())
    seen = Actuator(SEEN)

    low = State()
    high = State()

    @low.internal
    def _(self) -> None:
        self.seen(self.number)

    low.to(high, when=lambda m: m.number.data > 3)
    high.to(low, after_ms=30)


class Taker:
    """What a recorder does, when it is asked to."""

    def __init__(self, board: Board, pid: int = 0):
        self._board = board
        pid = pid or os.getpid()
        self._me = pid, born(pid), host_name(), pid_namespace()
        self._taken: list[int] = []
        self.parts: list[JournalPart] = []
        self.tell()

    def tell(self) -> Recorder:
        recorder = Recorder(*self._me, tuple(self._taken))
        self._board.add_message(RECORDER, recorder)
        return recorder

    def take(self) -> None:
        for number in range(4):
            slot = self._board[journal_slot(number)]
            if number == len(self._taken):
                self._taken.append(0)
            sample = slot.sample()
            if sample is not None and sample.count != self._taken[number]:
                self._taken[number] = sample.count
                self.parts.append(sample.message)
        self.tell()

    @property
    def data(self) -> bytes:
        return b"".join(part.data for part in self.parts)


def journalled(handover: Handover, board: Board, clock: ManualClock | None = None) -> Arrangement:
    live = LiveEnvironment(board, clock, handover=handover)
    return Arrangement([Echo], environment=JournalledEnvironment(live, handover.journal))


def journals_on(board: Board) -> list[str]:
    return [info.name for info in board.slots() if info.name.startswith(JOURNALS)]


def test_nobody_records_unless_a_process_that_lives_says_so() -> None:
    board = Whiteboard.local()
    here = host_name(), pid_namespace()
    assert find_recorder(board) is None
    board.add_message(RECORDER, Recorder())
    assert find_recorder(board) is None
    with subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE) as process:
        board.add_message(RECORDER, Recorder(process.pid, born(process.pid), *here))
        assert find_recorder(board) is not None
        process.kill()
        process.wait()
        assert find_recorder(board) is None
    board.add_message(RECORDER, Recorder(os.getpid(), born(os.getpid()) - 1, *here))
    assert find_recorder(board) is None


@given(st.lists(st.one_of(st.integers(1, 3 * SLOT), st.just(0)), max_size=30))
@settings(deadline=None, max_examples=examples(20))
def test_every_byte_comes_once_and_in_order_whenever_it_is_taken(steps: list[int]) -> None:
    board = Whiteboard.local()
    taker = Taker(board)
    handover = Handover(board, taker.tell(), whole=True)
    written = b""
    for number, size in enumerate(steps):
        if size:
            data = bytes([number]) * size
            written += size.to_bytes(4, "little") + data
            handover.write(data)
        else:
            taker.take()
    for _ in range(2 * len(written) // SLOT + 2):  # a part fills more than half of its slot
        taker.take()
        handover.go_on()
    taker.take()
    assert taker.data == written
    assert [part.number for part in taker.parts] == list(range(len(taker.parts)))


def test_what_is_not_taken_is_kept_up_to_a_limit_and_a_number_is_left_out(
    caplog: pytest.LogCaptureFixture,
) -> None:
    board = Whiteboard.local()
    taker = Taker(board)
    handover = Handover(board, taker.tell(), whole=True, limit=1000)
    for number in range(30):
        handover.write(bytes([number]) * 96)
    assert handover.works
    assert len(caplog.records) == 1
    for _ in range(3):
        taker.take()
        handover.go_on()
    assert [part.number for part in taker.parts] == [0, 3]  # it was full twice
    assert taker.data[4:5] == bytes([20])  # what came after the last loss, whole


def test_each_arrangement_has_a_slot_that_is_free_again_when_all_was_taken() -> None:
    board = Whiteboard.local()
    taker = Taker(board)
    first = Handover(board, taker.tell(), whole=True)
    Handover(board, taker.tell(), whole=True)
    assert journals_on(board) == [JOURNALS + "0", JOURNALS + "1"]
    taker.take()
    board.add_message(RECORDER, Recorder())
    first.go_on()
    assert not first.works  # and has left its slot
    other = Taker(board)
    Handover(board, other.tell(), whole=True)
    slots = journals_on(board)
    assert len(slots) > 2  # as nobody has taken its last part
    other.take()
    Handover(board, other.tell(), whole=False)
    begun = board.get_message(journal_slot(0))
    assert begun is not None
    assert (begun.number, begun.whole) == (0, False)
    assert journals_on(board) == slots


def test_a_board_has_room_for_so_many() -> None:
    board = Whiteboard.local()
    taker = Taker(board)
    held = [Handover(board, taker.tell(), whole=True) for _ in range(64)]
    with pytest.raises(BoardFullError, match="64 arrangements are recorded on it already"):
        Handover(board, taker.tell(), whole=True)
    assert held[0].works


def test_a_recorder_that_died_is_noticed(caplog: pytest.LogCaptureFixture) -> None:
    board = Whiteboard.local()
    with subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE) as process:
        handover = Handover(board, Taker(board, process.pid).tell(), whole=True)
        process.kill()
        process.wait()
    handover.go_on()
    assert not handover.works
    assert caplog.text.count("the recorder is gone: the machines go on unrecorded") == 1


CONTAINED = 1, 1, host_name(), pid_namespace() + 1  # it cannot be looked up from here


def test_a_recorder_in_another_container_is_there_as_long_as_it_posts(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    board = Whiteboard.local()
    board.add_message(RECORDER, Recorder(*CONTAINED))
    recorder = find_recorder(board)
    assert recorder is not None
    handover = Handover(board, recorder, whole=True)
    handover.go_on()
    assert handover.works
    monkeypatch.setattr(module, "SILENT_S", 0.0)
    assert find_recorder(board) is None
    monkeypatch.undo()
    board.add_message(RECORDER, Recorder())  # it has ended
    assert find_recorder(board) is None


def test_a_journal_in_another_container_keeps_its_slot(monkeypatch: pytest.MonkeyPatch) -> None:
    """Though everything was taken, and unless it is silent and there is no other slot."""
    board = Whiteboard.local()
    board.add_message(journal_slot(0), JournalPart(*CONTAINED, 3, whole=True, number=0))
    taker = Taker(board)
    taker.take()
    Handover(board, taker.tell(), whole=True)
    monkeypatch.setattr(module, "SILENT_S", 0.0)
    for _ in range(62):
        Handover(board, taker.tell(), whole=True)
    kept = board.get_message(journal_slot(0))
    assert kept is not None
    assert kept.namespace == CONTAINED[-1]
    monkeypatch.undo()
    with pytest.raises(BoardFullError):
        Handover(board, taker.tell(), whole=True)
    monkeypatch.setattr(module, "SILENT_S", 0.0)
    Handover(board, taker.tell(), whole=True)
    replaced = board.get_message(journal_slot(0))
    assert replaced is not None
    assert replaced.pid == os.getpid()


def test_who_loses_its_slot_logs_that_it_is_not_recorded(caplog: pytest.LogCaptureFixture) -> None:
    board = Whiteboard.local()
    taker = Taker(board)
    handover = Handover(board, taker.tell(), whole=True)
    board.add_message(journal_slot(0), JournalPart(*CONTAINED, 3, whole=True, number=0))
    taker.take()
    handover.write(b"entry")
    assert not handover.works
    assert caplog.text.count("another journal has this one's slot") == 1
    last = board.get_message(journal_slot(0))
    assert last is not None
    assert last.namespace == CONTAINED[-1]


def test_a_journal_without_entries_posts_signs_of_life() -> None:
    board = Whiteboard.local()
    taker = Taker(board)
    handover = Handover(board, taker.tell(), whole=True)

    def parts() -> int:
        handover.go_on()
        taker.take()
        return len(taker.parts)

    wait_for(lambda: parts() > 1, "a sign of life")
    assert [(part.number, part.data, part.over) for part in taker.parts[1:]] == [(1, b"", False)]


@pytest.fixture
def running() -> Iterator[tuple[Board, Arrangement, Any]]:
    """An arrangement that runs; each step is some rounds, and then what is reported."""
    board, clock = Whiteboard.local(), ManualClock()
    arrangement = Arrangement([Echo], whiteboard=board, clock=clock)

    def step(rounds: int = 5) -> None:
        for _ in range(rounds):
            clock.advance(ms=25)
            arrangement.round()
            presence.look(idle=True)

    presence = StatusPublisher(arrangement, board)
    return board, arrangement, step


def test_without_a_recorder_nothing_is_observed_and_nothing_handed_over(running: Any) -> None:
    board, arrangement, step = running
    step()
    board.add_message(RECORDER, Recorder())  # one has ended
    step()
    assert not arrangement.kernel.observers
    assert not journals_on(board)


def test_who_comes_later_gets_the_events_from_then_on_until_it_leaves(running: Any) -> None:
    board, arrangement, step = running
    step()
    taker = Taker(board)
    for _ in range(5):
        step()
        taker.take()
    found = list(entries(taker))
    assert [entry["event"] for entry in found[:2]] == ["Loaded", "RoundBegin"]
    assert found[0]["machine"] == "Echo"
    rounds = [entry["round"] for entry in found if entry["event"] == "RoundEnd"]
    assert rounds == list(range(rounds[0], rounds[0] + len(rounds)))
    assert rounds[0] > 5
    assert not any(part.whole for part in taker.parts)
    board.add_message(RECORDER, Recorder())
    step()
    assert not arrangement.kernel.observers
    later = Taker(board)
    for _ in range(3):
        step()
        later.take()
    assert later.parts[-1].session != taker.parts[-1].session
    assert journals_on(board) == [f"{JOURNALS}{n}" for n in range(4)]  # of which it uses one


def entries(taker: Taker) -> Iterator[dict[str, Any]]:
    data = taker.data
    while data:
        size = 4 + int.from_bytes(data[:4], "little")
        yield from entries_of(data[4:size])
        data = data[size:]


def test_the_end_of_machines_is_handed_over_before_their_run_returns(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    board, clock = Whiteboard.local(), ManualClock()
    taker = Taker(board)
    handover = Handover(board, taker.tell(), whole=True)
    arrangement = journalled(handover, board, clock)
    monkeypatch.setattr(module.time, "sleep", lambda _: taker.take())
    arrangement.run(max_rounds=3)
    taker.take()
    assert taker.parts[-1].over
    assert [*entries(taker)][-1]["event"] == "End"
    assert not handover.works


def test_machines_do_the_same_while_they_are_recorded_and_after() -> None:
    def run(record: bool) -> list[Any]:
        board, clock = Whiteboard.local(), ManualClock()
        found: list[Any] = []
        if record:
            handover = Handover(board, Taker(board).tell(), whole=True)
            arrangement = journalled(handover, board, clock)
        else:
            arrangement = Arrangement([Echo], whiteboard=board, clock=clock)
        for number in range(20):
            if record and number == 10:
                handover.journal.close()
                handover.journal.write = pytest.fail
                before = len(handover.journal.reads)
            board.add_message(NUMBER, Int32(data=number % 6))
            clock.advance(ms=12)
            arrangement.round()
            sample = board[SEEN].sample()
            found.append(
                (arrangement.roster.standings(), sample and sample.message, sample and sample[1])
            )
        if record:  # nothing is kept any more, and nothing tapped
            assert before == len(handover.journal.reads)
            assert not arrangement.kernel.observers
            assert not isinstance(arrangement.environment, JournalledEnvironment)
            arrangement.stop()
            arrangement.suspend("Echo")
            handover.journal.flush()
        return found

    assert run(record=True) == run(record=False)


def test_a_board_that_is_closed_at_the_end_is_no_failure() -> None:
    board = Whiteboard.local()
    handover = Handover(board, Taker(board).tell(), whole=True, patience_s=0.0)
    arrangement = journalled(handover, board)
    arrangement.round()
    board.close()
    arrangement.end()
    assert not handover.works
