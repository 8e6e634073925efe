"""What was recorded comes back as it was, in its time."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from llfsm.bridges.recording.reader import Recording
from llfsm.bridges.recording.replay import BoardReplay
from llfsm.bridges.recording.writer import RecordingWriter
from llfsm.runtime import Arrangement, Machine, ManualClock, State
from llfsm.runtime.engine.environment import Environment
from llfsm.runtime.journal.entries import Journal, entries_of
from llfsm.runtime.journal.journalled import JournalledEnvironment
from llfsm.whiteboard import Message, Sample, Slot, SlotTypeError, Whiteboard
from llfsm.whiteboard.messages.llfsm import (
    BELL,
    Bell,
    Commanders,
    MachineRequest,
    Viewer,
    commanders_slot,
    request_slot,
    viewer_slot,
)
from llfsm.whiteboard.messages.std_msgs import Bool
from llfsm.whiteboard.schema import to_plain
from llfsm.whiteboard.shared import boards
from thoroughness import examples
from waiting import PATIENCE_S

from .conftest import OTHER, READING, Reading, Spy, end_of, keep_journal

MS = 1_000_000


def never() -> bool:
    return False


def record(file: Path, times_ms: list[tuple[Slot[Any], Message, int]]) -> Recording:
    """Record messages that came so long after the beginning."""
    counts: dict[str, int] = {}
    file.unlink(missing_ok=True)
    with RecordingWriter(file, {}) as writer:
        for slot, message, ms in times_ms:
            counts[slot.name] = counts.get(slot.name, 0) + 1
            stamp_ns = writer.begin_ns + ms * MS
            writer.add(slot, Sample(message, counts[slot.name], stamp_ns, 1))
    return Recording(file)


def plain(added: list[tuple[int, str, Message]]) -> list[tuple[int, str, tuple[Any, ...]]]:
    return [
        (ns // MS, slot, tuple(getattr(m, f) for f in m.__struct_fields__)) for ns, slot, m in added
    ]


MESSAGES = [(READING, Reading(i, 0.1 * i), 100 * i) for i in range(8)]
MESSAGES += [(OTHER, Reading(-i), 100 * i + 50) for i in range(8)]
MESSAGES.sort(key=lambda each: each[2])


def fields(message: Message) -> tuple[Any, ...]:
    return tuple(getattr(message, name) for name in message.__struct_fields__)


@pytest.mark.parametrize("speed", [0.5, 1.0, 4.0])
def test_every_message_comes_in_its_time(file: Path, speed: float) -> None:
    clock = ManualClock()
    spy = Spy(clock.now_ns)
    BoardReplay(record(file, MESSAGES), spy).play(never, speed=speed, clock=clock)
    assert plain(spy.added) == [
        (int(ms / speed), slot.name, fields(message)) for slot, message, ms in MESSAGES
    ]


def test_from_a_time_on_the_board_is_as_it_was_then(file: Path) -> None:
    clock = ManualClock()
    spy = Spy(clock.now_ns)
    BoardReplay(record(file, MESSAGES), spy).play(never, from_s=0.32, clock=clock)
    found = [(ms, slot, values[0]) for ms, slot, values in plain(spy.added)]
    assert found[:3] == [(0, OTHER.name, -2), (0, READING.name, 3), (30, OTHER.name, -3)] or (
        found[:3] == [(0, READING.name, 3), (0, OTHER.name, -2), (30, OTHER.name, -3)]
    )
    assert found[3:] == [
        (ms - 320, slot.name, message.number) for slot, message, ms in MESSAGES if ms > 350
    ]


def test_it_ends_when_asked(file: Path) -> None:
    clock = ManualClock()
    spy = Spy(clock.now_ns)
    BoardReplay(record(file, MESSAGES), spy).play(lambda: clock.now_ns() >= 200 * MS, clock=clock)
    assert [ns // MS for ns, _, _ in spy.added] == [0, 50, 100, 150]


@given(
    st.lists(
        st.tuples(
            st.sampled_from([READING, OTHER]),
            st.builds(
                Reading,
                number=st.integers(-(2**63), 2**63 - 1),
                real=st.floats(allow_nan=False),
                data=st.binary(max_size=9),
                maybe=st.none() | st.floats(allow_nan=False),
                each=st.lists(st.floats(allow_nan=False), max_size=3).map(tuple),
            ),
        ),
        max_size=20,
    )
)
@settings(deadline=None, max_examples=examples(10))
def test_whatever_was_recorded_comes_back_equal(
    tmp_path_factory: pytest.TempPathFactory, messages: list[tuple[Slot[Reading], Reading]]
) -> None:
    timed = [(slot, message, i) for i, (slot, message) in enumerate(messages)]
    spy = Spy()
    recording = record(tmp_path_factory.mktemp("replay") / "run.mcap", timed)
    BoardReplay(recording, spy).play(never, clock=ManualClock())
    assert [(slot, fields(message)) for _, slot, message in spy.added] == [
        (slot.name, fields(message)) for slot, message in messages
    ]


def test_live_machines_are_asked_for_nothing_unless_that_is_named(file: Path) -> None:
    suspend, theirs = request_slot("Patrol"), viewer_slot("robot7")
    asking: list[tuple[Slot[Any], Message, int]] = [
        (BELL, Bell("Patrol"), 1),
        (suspend, MachineRequest("suspend"), 2),
        (theirs, Viewer(1), 2),
    ]
    recording = record(file, [*asking, (READING, Reading(), 3)])
    spy = Spy()
    BoardReplay(recording, spy).play(never, clock=ManualClock())
    assert [slot for _, slot, _ in spy.added] == [READING.name]
    spy = Spy()
    BoardReplay(recording, spy, ["llfsm/*"]).play(never, clock=ManualClock())
    assert [slot for _, slot, _ in spy.added] == [BELL.name, suspend.name, theirs.name]


def test_claims_to_slots_are_not_made_again(file: Path) -> None:
    claims = commanders_slot(READING.name)
    recording = record(file, [(claims, Commanders(READING.name), 1), (READING, Reading(), 2)])
    for patterns in ([], ["*"]):
        spy = Spy()
        BoardReplay(recording, spy, patterns).play(never, clock=ManualClock())
        assert [slot for _, slot, _ in spy.added] == [READING.name]


def test_only_slots_that_match_a_pattern(file: Path) -> None:
    spy = Spy()
    replay = BoardReplay(record(file, MESSAGES), spy, ["*/oth*", "nobody"])
    replay.play(never, clock=ManualClock())
    assert {slot for _, slot, _ in spy.added} == {OTHER.name}
    assert [info.name for info in spy.slots()] == [OTHER.name]


def test_a_slot_of_another_type_is_refused_before_anything_is_posted(file: Path) -> None:
    spy = Spy()
    spy.add_message(Slot(OTHER.name, Bool), Bool(data=True))
    spy.added.clear()
    with pytest.raises(SlotTypeError, match="robot/other"):
        BoardReplay(record(file, MESSAGES), spy)
    assert not spy.added


class Stay(Machine):
    here = State()
    there = State()
    here.to(there, when=lambda m: False)


def test_a_step_posts_what_belongs_to_one_ringlet(file: Path) -> None:
    written: list[bytes] = []
    clock = ManualClock()
    environment = JournalledEnvironment(Environment(clock), Journal(written.append))
    arrangement = Arrangement([Stay], environment=environment)
    with RecordingWriter(file, {}) as writer:
        clock.advance(ns=writer.begin_ns)
        with arrangement:
            for number in range(3):
                arrangement.round()
                for each in range(number):
                    clock.advance(ms=1)
                    count = 10 * number + each + 1
                    writer.add(READING, Sample(Reading(count), count, clock.now_ns(), 1))
                clock.advance(ms=10)
        keep_journal(writer, (entry for data in written for entry in entries_of(data)))
    spy = Spy()
    steps = list(BoardReplay(Recording(file), spy).steps())
    assert [(step.text, [m.number for _, m in step.posted]) for step in steps] == [
        ("round 1: Stay in here", []),
        ("round 2: Stay in here", [11]),
        ("round 3: Stay in here", [21, 22]),
    ]


class Walk(Machine):
    here = State()
    there = State()
    here.to(there, when=lambda m: m.after_ms(20))


def test_the_command_steps_to_where_something_happens(
    llfsm: Any, file: Path, board: Whiteboard
) -> None:
    written: list[bytes] = []
    clock = ManualClock()
    environment = JournalledEnvironment(Environment(clock), Journal(written.append))
    arrangement = Arrangement([Walk], environment=environment)
    with RecordingWriter(file, {}) as writer:
        clock.advance(ns=writer.begin_ns)
        with arrangement:
            for number in range(6):
                clock.advance(ms=10)
                arrangement.round()
                if number == 1:
                    writer.add(READING, Sample(Reading(1), 1, clock.now_ns() + MS, 1))
        keep_journal(writer, (entry for data in written for entry in entries_of(data)))
    printed, _ = llfsm("replay", file, "-b", board.name, "--step").communicate("\n" * 9)
    lines = [line.partition(" s  ")[2] or line for line in printed.splitlines()]
    assert lines == [
        "round 1: Walk in here",
        "round 2: Walk in here",
        f"  {READING.name} {json.dumps(to_plain(Reading(1)))}",
        "round 4: Walk in here, m.after_ms(20): to there",
    ]


def test_without_events_a_step_is_a_message(file: Path) -> None:
    spy = Spy()
    steps = BoardReplay(record(file, MESSAGES), spy).steps()
    for number, (slot, _, ms) in enumerate(MESSAGES, 1):
        step = next(steps)
        assert (step.now_ns, step.posted[0].slot, len(spy.added)) == (ms * MS, slot.name, number)


def test_the_command_brings_a_recording_onto_a_board(
    llfsm_here: Any, file: Path, board: Whiteboard
) -> None:
    record(file, MESSAGES)
    assert llfsm_here("replay", file, "-b", board.name, "--speed", 100) == (0, "")
    assert fields(board.get_message(board.find(READING.name))) == fields(Reading(7, 0.1 * 7))
    assert board[board.find(OTHER.name)].count == 8


def test_the_command_steps_at_each_line(llfsm: Any, file: Path, board: Whiteboard) -> None:
    record(file, MESSAGES)
    process = llfsm("replay", file, "-b", board.name, "--step")
    printed, _ = process.communicate("\n\n")
    assert [line.split()[0] for line in printed.splitlines()] == [
        "0.000000",
        READING.name,
        "0.050000",
        OTHER.name,
        "0.100000",
        READING.name,
    ]
    assert board[board.find(READING.name)].count == 2


def test_it_loops_until_the_board_is_gone(llfsm: Any, file: Path, board: Whiteboard) -> None:
    record(file, MESSAGES)
    process = llfsm("replay", file, "-b", board.name, "--loop", "--speed", 50)
    bound = board[OTHER]
    assert bound.wait(after=20, timeout=PATIENCE_S)
    board.remove()
    assert end_of(process) == (0, "")


@pytest.mark.parametrize(
    ("arguments", "why"),
    [
        (["nope.mcap"], "nope.mcap: cannot be read: No such file"),
        (["run.mcap", "--from", "99"], "--from 99: it ends after 0.75 s"),
        (["run.mcap", "--speed", "0"], "0.0 is not in the range"),
    ],
)
def test_wrong_use_is_one_line(llfsm_here: Any, file: Path, arguments: list[str], why: str) -> None:
    record(file, MESSAGES)
    status, printed = llfsm_here("replay", *arguments, "-b", "test-none")
    assert status in (1, 2)
    assert why in printed
    assert "Traceback" not in printed
    assert "test-none" not in {info.name for info in boards()}
