"""What is found by the index is what a reading of the whole file would find."""

from __future__ import annotations

import os
import tracemalloc
from itertools import islice
from pathlib import Path
from random import Random
from typing import Any

import pytest

from llfsm.bridges.recording.mcap_file import CACHED_CHUNKS, McapFile
from llfsm.bridges.recording.reader import RecordedMessage, Recording
from llfsm.bridges.recording.writer import RecordingWriter
from llfsm.whiteboard import Message, Sample, Slot
from llfsm.whiteboard.messages.llfsm import MachineDefinition, definition_slot

from .conftest import READING, Reading, messages_of

MS = 1_000_000
SLOTS = [Slot(f"slot/{name}", Reading) for name in "abc"]
DEFINITION = definition_slot("M")


Script = list[tuple[str, int, int]]


def script(random: Random) -> Script:
    """Return what to do, by which writer, and how much later than the newest message so far."""
    what = random.choices(["a", "b", "c", "flush", "define"], [6, 2, 2, 2, 0.3], k=80)
    return [(each, random.randint(1, 2), random.randint(0, 9)) for each in what]


def record(file: Path, script: Script) -> tuple[int, list[tuple[str, Any]]]:
    """Return when it began, and each slot's name and its `(seen, stamp, count, writer)`."""
    counts: dict[str, int] = {}
    latest: dict[str, int] = {}
    written = []
    with RecordingWriter(file, {}) as writer:
        now_ns = begin_ns = writer.begin_ns - 30 * MS
        for what, process, later in script:
            now_ns += later * MS
            if what == "flush":
                writer.flush()
                continue
            slot: Slot[Any] = DEFINITION if what == "define" else SLOTS["abc".index(what)]
            counts[slot.name] = count = counts.get(slot.name, 0) + 1
            # Others are written late, as a slot is looked at after the next one has news.
            stamp_ns = max(now_ns - (0 if what == "a" else 7 * MS), latest.get(slot.name, 0))
            latest[slot.name] = stamp_ns
            message: Message = MachineDefinition("m", ()) if what == "define" else Reading(count)
            writer.add(slot, Sample(message, count, stamp_ns, process))
            seen_ns = max(stamp_ns, writer.begin_ns)
            written.append((slot.name, (seen_ns, stamp_ns, count, process)))
    return begin_ns, written


def plain(recorded: RecordedMessage | None) -> Any:
    return recorded and (recorded.seen_ns, recorded.stamp_ns, recorded.count, recorded.writer)


@pytest.mark.parametrize("cut", [0, 40], ids=["complete", "cut"])
def test_every_moment_is_found_in_whatever_order_it_is_asked_for(tmp_path: Path, cut: int) -> None:
    random = Random(1)
    for _ in range(40):
        file = tmp_path / "run.mcap"
        file.unlink(missing_ok=True)
        begin_ns, written = record(file, script(random))
        if cut:
            os.truncate(file, file.stat().st_size - cut)
        recording = Recording(file)
        assert recording.complete == (not cut)
        for now_ns in [begin_ns + random.randint(-5, 400) * MS for _ in range(25)]:
            for name, slot in recording.slots.items():
                known = [each for n, each in written if n == name and each[0] <= now_ns]
                expected = max(known, key=lambda each: each[2], default=None)
                assert plain(recording.latest(slot, now_ns)) == expected
            names = {"slot/a", "slot/c"}
            found = [plain(each) for _, each in recording.messages(names, now_ns)]
            expected_all = [each for n, each in written if n in names and each[0] >= now_ns]
            assert sorted(found) == sorted(expected_all)
            assert [each[0] for each in found] == sorted(each[0] for each in found)
        everything = [plain(each) for _, each in recording.messages()]
        assert sorted(everything) == sorted(each for _, each in written)


def large(file: Path, chunks: int) -> int:
    """Make a file of so many chunks of which each is a little over a megabyte."""
    data = os.urandom(1 << 16)
    count = 0
    with RecordingWriter(file, {}) as writer:
        for _ in range(chunks * 16):
            count += 1
            stamp_ns = writer.begin_ns + count * MS
            slot = SLOTS[count % 3] if count % 100 else READING
            writer.add(slot, Sample(Reading(count, data=data[: 48 << 10]), count, stamp_ns, 1))
    return count


@pytest.mark.parametrize("cut", [0, 5000], ids=["complete", "cut"])
def test_no_more_of_a_file_is_in_memory_than_is_looked_at(file: Path, cut: int) -> None:
    number = large(file, 100)
    if cut:
        os.truncate(file, file.stat().st_size - cut)
    tracemalloc.start()
    try:
        recording = Recording(file)
        assert len(recording.chunks) > 90  # a megabyte each
        assert tracemalloc.get_traced_memory()[1] < 8_000_000  # it begins at once
        tracemalloc.reset_peak()
        (_, first), *_ = islice(recording.messages(), 3)
        assert first.count == 1
        begin_ns, end_ns = recording.span_ns
        for part in (9, 2, 5, 0, 7, 10):
            for slot in recording.slots.values():
                recording.latest(slot, begin_ns + (end_ns - begin_ns) * part // 10)
        assert sum(1 for _ in recording.messages()) > number - 40
        assert tracemalloc.get_traced_memory()[1] < 2 * (CACHED_CHUNKS + 4) * 1_100_000
    finally:
        tracemalloc.stop()


def test_of_large_chunks_fewer_are_kept(file: Path) -> None:
    """All of them would take 160 MB."""
    with RecordingWriter(file, {}) as writer:
        for count in range(1, CACHED_CHUNKS + 1):
            stamp_ns = writer.begin_ns + count * MS
            reading = Reading(count, data=bytes(10_000_000))
            writer.add(READING, Sample(reading, count, stamp_ns, 1))
    tracemalloc.start()
    try:
        recording = Recording(file)
        for chunk in recording.chunks:
            recording.latest(recording.slots[READING.name], writer.begin_ns + (chunk + 1) * MS)
        assert tracemalloc.get_traced_memory()[0] < 90_000_000
    finally:
        tracemalloc.stop()


def test_a_damaged_chunk_is_left_out_with_one_warning(
    file: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with RecordingWriter(file, {}) as writer:
        for count in range(1, 31):
            stamp_ns = writer.begin_ns + count * MS
            writer.add(READING, Sample(Reading(count), count, stamp_ns, 1))
            if count % 10 == 0:
                writer.flush()
    whole = file.read_bytes()
    chunks = McapFile(file).chunks
    middle = (chunks[1].offset + chunks[2].offset) // 2 - 40
    file.write_bytes(whole[:middle] + bytes([whole[middle] ^ 0x55]) + whole[middle + 1 :])
    recording = Recording(file)
    assert recording.complete
    for _ in range(3):
        found = [each.count for each in messages_of(recording, READING.name)]
        assert found == [*range(1, 11), *range(21, 31)]
    assert not recording.complete
    assert caplog.text.count("a part of it is damaged and left out") == 1
    latest = recording.latest(recording.slots[READING.name], recording.span_ns[0] + 15 * MS)
    assert latest is not None
    assert latest.count == 10
