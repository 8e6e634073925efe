"""A recording as a page sees it, at each moment."""

from __future__ import annotations

import os
from itertools import pairwise
from pathlib import Path
from typing import Any
from urllib.request import urlopen

import msgspec
import pytest

from llfsm.bridges.recording.errors import RecordingFileError
from llfsm.bridges.recording.page import RecordedSource
from llfsm.bridges.recording.writer import RecordingWriter
from llfsm.bridges.view.page_source import Change
from llfsm.runtime import Arrangement, Machine, ManualClock, State
from llfsm.runtime.journal.entries import Journal, entries_of
from llfsm.runtime.journal.journalled import JournalledEnvironment
from llfsm.runtime.presence.live import LiveEnvironment
from llfsm.runtime.presence.status_publisher import StatusPublisher
from llfsm.whiteboard import Sample, Whiteboard
from llfsm.whiteboard.messages.llfsm import MachineStatus, status_slot

from .conftest import OTHER, READING, Reading, end_of, foreign_writer, keep_journal

MS = 1_000_000
STATUS = status_slot("Patrol")


@pytest.fixture
def clock() -> ManualClock:
    return ManualClock()


@pytest.fixture
def source(file: Path, clock: ManualClock) -> RecordedSource:
    """A reading each 100 ms for 3 s, another slot from 1 s on, a machine up to 2 s."""
    with RecordingWriter(file, {}) as writer:
        begin_ns = writer.begin_ns
        for i in range(31):
            stamp_ns = begin_ns + i * 100 * MS
            writer.add(READING, Sample(Reading(i), i + 1, stamp_ns, 7))
            if i >= 10:
                writer.add(OTHER, Sample(Reading(-i), i, stamp_ns, 8))
            if i <= 20 and i % 2 == 0:
                state, since = ("wait", i) if i < 8 else ("go", i - 7)
                status = MachineStatus(state=state, in_state_s=since / 10, suspended=i == 20)
                writer.add(STATUS, Sample(status, i // 2 + 1, stamp_ns, 9))
    return RecordedSource(file, clock)


def numbers(source: RecordedSource) -> dict[str, int]:
    return {
        name: sample.message.number
        for name, sample in source.snapshot().samples.items()
        if name != STATUS.name
    }


def test_it_is_paused_at_the_beginning(source: RecordedSource, clock: ManualClock) -> None:
    assert numbers(source) == {READING.name: 0}
    clock.advance(s=5)
    assert numbers(source) == {READING.name: 0}
    assert [*source.snapshot().slots] == [READING.name, STATUS.name, OTHER.name]
    assert source.title == "run.mcap"
    assert source.board() is None


@pytest.mark.parametrize("machine", [True, False])
def test_it_opens_where_there_is_something_to_see(file: Path, machine: bool) -> None:
    """A machine that runs; without one, a message. What had ended before is no such machine."""
    with RecordingWriter(file, {}) as writer:
        begin_ns = writer.begin_ns
        writer.add(OTHER, Sample(Reading(1), 1, begin_ns + 200 * MS, 8))
        if machine:
            ended = MachineStatus(loaded=False)
            writer.add(status_slot("Ended"), Sample(ended, 1, begin_ns + 100 * MS, 9))
            writer.add(STATUS, Sample(MachineStatus(state="wait"), 1, begin_ns + 900 * MS, 9))
    seen = RecordedSource(file).snapshot()
    assert seen.now_ns == begin_ns + (900 if machine else 200) * MS
    assert (STATUS.name in seen.samples) == machine


def test_a_leap_shows_that_moment_and_a_new_epoch(source: RecordedSource) -> None:
    first_ns, last_ns = source.player.span_ns
    assert last_ns - first_ns == 3000 * MS
    epochs = {source.snapshot().epoch}
    for ms in (1550, 0, 2999, 1000):
        source.player.seek(first_ns + ms * MS)
        look = source.snapshot()
        assert look.now_ns == first_ns + ms * MS
        assert look.samples[READING.name].count == ms // 100 + 1
        assert (OTHER.name in look.samples) == (ms >= 1000)
        assert look.epoch not in epochs
        epochs.add(look.epoch)


def test_it_plays_at_the_requested_speed_and_pauses_at_the_end(
    source: RecordedSource, clock: ManualClock
) -> None:
    player = source.player
    player.play(2.0)
    clock.advance(ms=500)
    assert numbers(source)[READING.name] == 10
    player.play(0.5)
    clock.advance(ms=1000)
    assert numbers(source)[READING.name] == 15
    player.play(0)
    clock.advance(s=9)
    assert numbers(source)[READING.name] == 15
    epoch = source.snapshot().epoch
    player.play(100)
    clock.advance(s=1)
    assert numbers(source)[READING.name] == 30
    assert player.speed == 0
    assert source.snapshot().epoch == epoch
    player.play(1)  # from the beginning again
    assert numbers(source)[READING.name] == 0
    assert source.snapshot().epoch != epoch


def test_a_sample_is_what_the_board_had(source: RecordedSource) -> None:
    first_ns = source.player.span_ns[0]
    source.player.seek(first_ns + 350 * MS)
    sample = source.snapshot().samples[READING.name]
    assert sample[1:] == (4, first_ns + 300 * MS, 7)
    assert msgspec.structs.astuple(sample.message) == msgspec.structs.astuple(Reading(3))


def test_the_states_of_machines_are_known_from_the_beginning(source: RecordedSource) -> None:
    first_ns = source.player.span_ns[0]
    assert source.history() == {
        "Patrol": [
            Change(first_ns, "wait", False),
            Change(first_ns + 700 * MS, "go", False),
            Change(first_ns + 2000 * MS, "go", True),
        ]
    }


@pytest.mark.parametrize(("ms", "live"), [(0, True), (2000, True), (3000, True)])
def test_a_machine_lives_until_it_was_silent_for_a_second(
    source: RecordedSource, ms: int, live: bool
) -> None:
    source.player.seek(source.player.span_ns[0] + ms * MS)
    assert source.is_live(source.snapshot().samples[STATUS.name]) is live


def test_a_machine_that_dies_is_gone_in_history(file: Path) -> None:
    with RecordingWriter(file, {}) as writer:
        begin_ns = writer.begin_ns
        for count, (ms, status) in enumerate(
            [
                (0, MachineStatus(state="a")),
                (200, MachineStatus(state="a", in_state_s=0.2)),
                (2000, MachineStatus(state="b")),
                (2500, MachineStatus(state="b", loaded=False)),
                (2600, MachineStatus(state="a")),
            ],
            1,
        ):
            writer.add(STATUS, Sample(status, count, begin_ns + ms * MS, 1))
        writer.add(READING, Sample(Reading(), 1, begin_ns + 9000 * MS, 1))
    source = RecordedSource(file)
    found = [((c.stamp_ns - begin_ns) // MS, c.state) for c in source.history()["Patrol"]]
    assert found == [(0, "a"), (1200, ""), (2000, "b"), (2500, ""), (2600, "a"), (3600, "")]
    source.player.seek(begin_ns + 3500 * MS)
    assert source.is_live(source.snapshot().samples[STATUS.name])
    source.player.seek(begin_ns + 3700 * MS)
    assert not source.is_live(source.snapshot().samples[STATUS.name])


def test_an_invalid_message_is_a_problem_of_its_slot(file: Path) -> None:
    with foreign_writer(file) as writer:
        schema = writer.register_schema("R", "jsonschema", msgspec.json.encode(READING.schema))
        about = {"writer": "7", "capacity": "64", "wraps": "0"}
        channel = writer.register_channel(READING.name, "json", schema, about)
        writer.add_message(channel, 0, b'{"number": 1', 0, 1)
    snapshot = RecordedSource(file).snapshot()
    assert not snapshot.samples
    assert "message 1" in snapshot.problems[READING.name]


def test_a_file_that_is_not_a_recording_is_an_error(file: Path) -> None:
    file.write_text("?")
    with pytest.raises(RecordingFileError):
        RecordedSource(file)


def test_the_command_shows_a_recording(llfsm: Any, source: RecordedSource, file: Path) -> None:
    process = llfsm("view", file.name, "--no-open", "--port", "0")
    printed = process.stdout.readline()
    assert printed.startswith("llfsm view: run.mcap at http://127.0.0.1:")
    with urlopen(printed.split()[-1]) as answer:
        assert b"<html" in answer.read()
    process.terminate()
    assert end_of(process)[0] == 0


def test_the_command_says_what_is_no_recording(llfsm_here: Any, file: Path) -> None:
    file.write_text("?")
    assert llfsm_here("view", file.name, "--no-open") == (
        1,
        "Error: run.mcap: is not a recording of llfsm, nor a bag of ROS 2\n",
    )


class Hasty(Machine):
    """States that are shorter than anybody can look, and one that stays."""

    a = State()
    b = State()
    c = State()
    stay = State()
    a.to(b)
    b.to(c)
    c.to(stay)
    stay.to(a, after_ms=200)


def hasty(file: Path, *, events: bool) -> RecordedSource:
    """Record three rounds of it, with the statuses that can be seen."""
    clock, written, board = ManualClock(), [], Whiteboard.local()
    with RecordingWriter(file, {}) as writer:
        clock.advance(ns=writer.begin_ns)
        live = LiveEnvironment(board, clock)
        environment = JournalledEnvironment(live, Journal(written.append))
        arrangement = Arrangement([Hasty], environment=environment)
        presence, count = StatusPublisher(arrangement, board), 0
        for number in range(160):
            clock.advance(ms=5)
            arrangement.round()
            presence.look(idle=False)  # fifty times a second
            sample = board[status_slot("Hasty")].sample()
            if sample is not None and sample.count != count:
                count = sample.count
                writer.add(status_slot("Hasty"), sample._replace(stamp_ns=clock.now_ns()))
            if number == 80:
                writer.flush()
        arrangement.end()
        entries = [entry for data in written for entry in entries_of(data)]
        if events:
            keep_journal(writer, entries, process=os.getpid())
    return RecordedSource(file)


def test_with_events_every_state_is_known_however_short(file: Path) -> None:
    source = hasty(file, events=True)
    while len(changes := source.history()["Hasty"]) < 13:
        assert source.history()
    assert [change.state for change in changes[:9]] == [*"abc", "stay", *"abc", "stay", "a"]
    ways = [(change.source, change.transition) for change in changes[4:9]]
    assert ways == [("stay", 0), ("a", 0), ("b", 0), ("c", 0), ("stay", 0)]
    assert not any(change.skipped for change in changes)
    stamps = [change.stamp_ns for change in changes]
    assert stamps[6] - stamps[5] == 5 * MS
    assert source.player.known_ns == source.player.span_ns[1]


class Breaks(Machine):
    """Fail when it is resumed for the first time, and not when it is resumed again."""

    tries: int = 0
    a = State()
    b = State()
    a.to(b, after_ms=50)

    @b.on_entry
    def _(self) -> None:
        raise ValueError("no plan")


@pytest.mark.parametrize("events", [True, False])
def test_a_failure_is_in_the_history_until_the_machine_is_resumed(file: Path, events: bool) -> None:
    clock, written, board = ManualClock(), [], Whiteboard.local()
    slot, condition = status_slot("Breaks"), {}
    with RecordingWriter(file, {}) as writer:
        clock.advance(ns=writer.begin_ns)
        environment = JournalledEnvironment(LiveEnvironment(board, clock), Journal(written.append))
        arrangement = Arrangement([Breaks], environment=environment, on_error="suspend")
        presence, count = StatusPublisher(arrangement, board, clock=clock), 0
        for number in range(40):
            if number == 20:
                arrangement.restart("Breaks")
            clock.advance(ms=10)
            arrangement.round()
            presence.look(idle=True)
            sample = board[slot].sample()
            if sample is not None and sample.count != count:
                count = sample.count
                writer.add(slot, sample._replace(stamp_ns=clock.now_ns()))
                condition[clock.now_ns()] = sample.message
        arrangement.end()
        if events:
            entries = [entry for data in written for entry in entries_of(data)]
            keep_journal(writer, entries, process=os.getpid())
    source = RecordedSource(file)
    while source.player.known_ns < source.player.span_ns[1]:
        source.history()
    changes = [(c.state, c.suspended, c.failed) for c in source.history()["Breaks"]]
    failed = ("Suspended", True, True)
    seen = [("a", False, False), failed, ("a", False, False), failed]
    assert [change for change in changes if change[0] not in ("", "b")] == seen
    for now_ns, status in condition.items():  # a moment after it was published
        source.player.seek(now_ns + 1)
        shown = source.snapshot().samples[slot.name].message
        assert (shown.failed, shown.error, shown.error_state) == (
            status.failed,
            status.error,
            status.error_state,
        )
    assert "machine Breaks, state b, OnEntry: ValueError: no plan" in shown.error
    assert shown.error_state == "b"


def test_without_events_what_was_too_short_is_marked(file: Path) -> None:
    changes = hasty(file, events=False).history()["Hasty"]
    states = [change.state for change in changes if change.state]
    assert len(states) < 12  # it was in more
    before = {"a": "stay", "b": "a", "c": "b", "stay": "c"}
    for last, change in pairwise(changes):
        if last.state and change.state:
            assert change.skipped == (before[change.state] != last.state), changes
            assert change.source == before[change.state]
    assert any(change.skipped for change in changes)
