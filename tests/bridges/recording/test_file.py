"""The file: what every MCAP tool finds in it, and what is left of one that was cut or damaged."""

from __future__ import annotations

import math
import os
import random
import subprocess
import sys
from collections import Counter
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import msgspec
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from mcap.exceptions import EndOfFile
from mcap.reader import make_reader
from mcap.records import Message
from mcap.stream_reader import StreamReader
from mcap.writer import Writer

from llfsm.bridges.recording.errors import RecordingFileError
from llfsm.bridges.recording.reader import Recording
from llfsm.bridges.recording.writer import ABOUT, STATISTICS, RecordingWriter
from llfsm.whiteboard import Sample, Slot, Whiteboard
from llfsm.whiteboard.messages.geometry_msgs import Twist, Vector3
from llfsm.whiteboard.messages.llfsm import (
    DefinedBox,
    DefinedState,
    MachineDefinition,
    definition_slot,
)
from llfsm.whiteboard.schema import describe
from thoroughness import examples

from .conftest import OTHER, READING, Reading, foreign_writer, messages_of, samples_of, write

READINGS = [Reading(i, i / 7, "ü" * (i % 5), bytes([i % 256])) for i in range(200)]


def plain(recording: Recording) -> list[tuple[str, Sample[Any]]]:
    return [(slot.slot.name, slot.sample(each)) for slot, each in recording.messages()]


def same(found: list[Any], written: list[Any]) -> bool:
    """Compare what has classes made from schemas with what has its own."""
    encode = msgspec.msgpack.encode
    return [(n, encode(s.message), *s[1:]) for n, s in found] == [
        (slot.name, encode(s.message), *s[1:]) for slot, s in written
    ]


def test_what_is_read_is_what_was_written(file: Path) -> None:
    board = Whiteboard.local()
    written = samples_of(board, READING, READINGS) + samples_of(board, OTHER, READINGS[:3])
    write(file, written)
    recording = Recording(file)
    assert recording.complete
    assert same(plain(recording), written)
    assert recording.about["board"] == "test"


def test_the_librarys_own_readers_accept_it(file: Path) -> None:
    written = samples_of(Whiteboard.local(), READING, READINGS)
    write(file, written)
    with file.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        summary = reader.get_summary()
        assert summary.statistics.message_count == len(READINGS)
        found = list(reader.iter_messages())
        names = {metadata.name for metadata in reader.iter_metadata()}
    assert names == {"llfsm/recording", STATISTICS}
    for (schema, channel, message), (slot, sample) in zip(found, written, strict=True):
        assert (channel.topic, channel.message_encoding) == (slot.name, "json")
        assert channel.metadata["writer"] == str(os.getpid())
        assert (schema.name, schema.encoding) == (slot.type_name, "jsonschema")
        assert msgspec.json.decode(schema.data) == describe(Reading)
        assert msgspec.json.decode(message.data)["number"] == sample.message.number
        assert message.sequence == sample.count


def test_one_without_its_end_is_read_by_the_librarys_stream_reader(file: Path) -> None:
    with RecordingWriter(file, {}) as writer:
        for slot, sample in samples_of(Whiteboard.local(), READING, READINGS):
            writer.add(slot, sample)
        writer.flush()
        whole = file.read_bytes()  # as a killed process leaves it
    with make_cut(file, whole, len(whole)).open("rb") as stream:
        records = StreamReader(stream, validate_crcs=True).records
        for number in range(1, len(READINGS) + 1):
            message = next(record for record in records if isinstance(record, Message))
            assert message.sequence == number
        with pytest.raises(EndOfFile):
            next(record for record in records if isinstance(record, Message))


def make_cut(file: Path, data: bytes, length: int) -> Path:
    cut = file.with_name("cut.mcap")
    cut.write_bytes(data[:length])
    return cut


def test_wherever_it_is_cut_all_flushed_before_is_there(file: Path) -> None:
    board, written, flushed = Whiteboard.local(), [], []
    with RecordingWriter(file, {}) as writer:
        begun = writer.size
        for i in range(10):
            for slot, sample in samples_of(board, READING, READINGS[20 * i : 20 * i + 20]):
                writer.add(slot, sample)
                written.append((slot, sample))
            writer.flush()
            flushed.append(writer.size)
    whole = file.read_bytes()
    for length in random.Random(1).sample(range(begun, len(whole)), 120) + flushed:
        recording = Recording(make_cut(file, whole, length))
        found = plain(recording)
        assert not recording.complete
        assert same(found, written[: len(found)])
        assert len(found) >= 20 * sum(size <= length for size in flushed)


@settings(max_examples=examples(25))
@given(st.lists(st.sampled_from(["reading", "other", "journal", "entry", "flush"]), max_size=16))
@example(["reading", "flush", "reading", "journal", "flush", "entry"])
def test_whatever_was_flushed_is_there_in_whichever_chunk_its_channel_was_defined(
    steps: list[str],
) -> None:
    board, written, entries = Whiteboard.local(), [], Counter[int]()
    with TemporaryDirectory() as folder:
        file = Path(folder) / "run.mcap"
        with RecordingWriter(file, {}) as writer:
            journals = []
            for step in steps:
                if step == "journal":
                    about = {"session": f"{len(journals)}-0", "writer": str(len(journals))}
                    journals.append(writer.add_journal({**about, "whole": "yes"}))
                elif step == "entry" and journals:
                    writer.add_entry(
                        journals[-1], {"event": "Asked", "action": "stop", "machine": None}
                    )
                    entries[len(journals) - 1] += 1
                elif step == "flush":
                    writer.flush()
                elif step in ("reading", "other"):
                    slot = READING if step == "reading" else OTHER
                    written += (new := samples_of(board, slot, [Reading()]))
                    writer.add(*new[0])
            writer.flush()
            whole = file.read_bytes()
        recording = Recording(make_cut(file, whole, len(whole)))
        assert same(plain(recording), written)
        found = {each.process: len([*recording.entries(each)]) for each in recording.journals}
        assert {process: number for process, number in found.items() if number} == entries


def test_a_damaged_byte_costs_no_more_than_what_comes_after(file: Path) -> None:
    write(file, samples_of(Whiteboard.local(), READING, READINGS))
    whole = bytearray(file.read_bytes())
    outcomes: Counter[str] = Counter()
    for position in random.Random(2).sample(range(len(whole)), 300):
        damaged = bytearray(whole)
        damaged[position] ^= 0x55
        try:
            found = len(plain(Recording(make_cut(file, bytes(damaged), len(damaged)))))
            outcomes[str(found in (0, len(READINGS)))] += 1
        except RecordingFileError:
            outcomes["refused"] += 1
    assert outcomes["True"] > 100


def other_tool(path: Path) -> None:
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        writer.finish()


@pytest.mark.parametrize(
    ("make", "why"),
    [
        (lambda path: None, "cannot be read: No such file or directory"),
        (Path.mkdir, "is a folder without metadata.yaml, so it is not a bag; .* was cut short"),
        (Path.touch, "is not a recording of llfsm, nor a bag of ROS 2"),
        (
            lambda path: path.write_text("hello\n" * 100),
            "is not a recording of llfsm, nor a bag of ROS 2",
        ),
        (other_tool, "is not a recording of llfsm, nor a bag of ROS 2"),
    ],
)
def test_a_file_that_is_not_a_recording_is_an_error_that_names_it(
    file: Path, make: Any, why: str
) -> None:
    make(file)
    with pytest.raises(RecordingFileError, match=f"^{file}: {why}$"):
        Recording(file)


def test_a_recording_is_private_to_its_user_as_its_board_is(file: Path) -> None:
    before = os.umask(0)
    try:
        write(file, [])
    finally:
        os.umask(before)
    assert file.stat().st_mode & 0o777 == 0o600


@pytest.mark.parametrize("key", ["offset_ns", "begin_ns"])
@pytest.mark.parametrize("value", ["x", "", "1.5", "9" * 5000, str(2**63)])
def test_metadata_that_are_no_numbers_are_an_error(file: Path, key: str, value: str) -> None:
    with file.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="llfsm")
        writer.add_metadata(ABOUT, {"offset_ns": "0", "begin_ns": "0"} | {key: value})
        writer.finish()
    with pytest.raises(RecordingFileError, match="has invalid metadata"):
        Recording(file)


@pytest.mark.parametrize("key", ["writer", "capacity", "wraps"])
@pytest.mark.parametrize("value", ["x", "9" * 5000, str(2**63)])
def test_a_channel_whose_metadata_are_no_numbers_is_an_error(
    file: Path, key: str, value: str
) -> None:
    schema = msgspec.json.encode(describe(Twist))
    with foreign_writer(file) as writer:
        number = writer.register_schema("Twist", "jsonschema", schema)
        about = {"writer": "1", "capacity": "1024", "wraps": "0"} | {key: value}
        writer.register_channel("x", "json", number, about)
    with pytest.raises(RecordingFileError, match="has an invalid channel"):
        Recording(file)


@pytest.mark.timeout(60)  # it would take for ever
def test_patterns_of_the_file_are_not_run(file: Path) -> None:
    text = "a" * 50 + "!"
    field = {"type": "string", "pattern": "^(a+)+$"}
    schema = {"title": "Odd", "type": "object", "properties": {"t": field}, "required": ["t"]}
    with foreign_writer(file) as writer:
        number = writer.register_schema("Odd", "jsonschema", msgspec.json.encode(schema))
        about = {"writer": "1", "capacity": "1024", "wraps": "0"}
        channel = writer.register_channel("x", "json", number, about)
        writer.add_message(channel, 1, msgspec.json.encode({"t": text}), 1, 1)
    ((slot, recorded),) = Recording(file).messages()
    assert slot.sample(recorded).message.t == text


@pytest.mark.parametrize("deep", [500, 100_000])
def test_a_schema_that_is_deeply_nested_is_an_error(file: Path, deep: int) -> None:
    with foreign_writer(file) as writer:
        schema = b'{"a":' * deep + b"1" + b"}" * deep
        number = writer.register_schema("Deep", "jsonschema", schema)
        writer.register_channel(
            "x", "json", number, {"writer": "1", "capacity": "1024", "wraps": "0"}
        )
    with pytest.raises(RecordingFileError, match="has an invalid channel"):
        Recording(file)


def test_a_recording_is_never_overwritten(file: Path) -> None:
    write(file, [])
    before = file.read_bytes()
    with pytest.raises(RecordingFileError, match="is there already"):
        write(file, [])
    assert file.read_bytes() == before


def test_a_folder_that_is_not_there_is_named(tmp_path: Path) -> None:
    file = tmp_path / "no" / "run.mcap"
    with pytest.raises(RecordingFileError, match=f"^{file}: cannot be written: No such file"):
        write(file, [])


def test_counts_go_on_beyond_what_the_file_can_say(file: Path) -> None:
    slot = Slot("x", Twist)
    counts = [2**32 - 2, 2**32 - 1, 2**32, 2**32 + 5]
    samples = [(slot, Sample(Twist(linear=Vector3(x=math.pi)), c, 10 * c, 7)) for c in counts]
    write(file, samples)
    assert [each.count for each in messages_of(Recording(file), "x")] == counts


def test_what_was_missed_is_counted(file: Path) -> None:
    samples = samples_of(Whiteboard.local(), READING, READINGS[:10])
    with RecordingWriter(file, {}) as writer:
        for slot, sample in samples[2:4] + samples[7:]:
            writer.add(slot, sample)
        assert writer.missed() == {READING.name: 3}
        assert writer.messages == 5
    with file.open("rb") as stream:
        metadata = {m.name: m.metadata for m in make_reader(stream).iter_metadata()}
    assert metadata[STATISTICS] == {READING.name: "5 recorded, 3 missed"}


def test_a_message_from_before_was_seen_when_the_recording_began(file: Path) -> None:
    samples = samples_of(Whiteboard.local(), READING, READINGS[:1])
    write(file, samples)
    ((_, recorded),) = Recording(file).messages()
    assert recorded.stamp_ns == samples[0][1].stamp_ns
    assert recorded.seen_ns == Recording(file).span_ns[0] > recorded.stamp_ns


def test_every_writer_is_known(file: Path) -> None:
    slot = Slot("x", Twist)
    samples = [(slot, Sample(Twist(), count, count, 100 + count % 3)) for count in range(1, 10)]
    write(file, samples)
    assert same(plain(Recording(file)), samples)


def test_without_the_library_what_to_install_is_reported(tmp_path: Path) -> None:
    hidden = "import sys; sys.modules['mcap'] = None; sys.argv[1:] = ['record', '--help']; "
    code = f"{hidden}from llfsm.cli.root import main; main()"
    done = subprocess.run([sys.executable, "-c", code], text=True, capture_output=True, check=False)
    assert done.returncode == 1
    assert done.stderr == (
        "Error: recordings need mcap; install it with: pip install 'llfsm[record]'\n"
    )


def test_definitions_are_attachments_and_come_back_as_messages(file: Path) -> None:
    box = DefinedBox(1.5, -2.0, 80.0, 40.0, expanded=True)
    states = (DefinedState("ä <b>", box=box), DefinedState("end"))
    slot, definition = definition_slot("M"), MachineDefinition("m:M", states, "end")
    samples = samples_of(Whiteboard.local(), slot, [definition, MachineDefinition("m:M", ())])
    write(file, samples)
    with file.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        found = {each.name: each.media_type for each in reader.iter_attachments()}
        assert reader.get_summary().statistics.attachment_count == 2
        assert not list(reader.iter_messages())
    assert found == {slot.name: "application/json"}
    recording = Recording(file)
    assert plain(recording) == [(each.name, sample) for each, sample in samples]
    latest = recording.latest(recording.slots[slot.name], recording.span_ns[1])
    assert latest is not None
    assert (latest.count, latest.writer) == (2, os.getpid())


@pytest.mark.parametrize(
    "data",
    [b"", b"[]", b'{"path": "x"}', b'{"$count": 1, "$writer": "x"}', b"\xff"],
)
def test_an_invalid_definition_is_an_error(file: Path, data: bytes) -> None:
    with foreign_writer(file) as writer:
        writer.add_attachment(1, 1, "llfsm/definition/x", "application/json", data)
    with pytest.raises(RecordingFileError, match="has an invalid channel or attachment"):
        Recording(file)


def test_what_others_attach_is_left_alone(file: Path) -> None:
    with foreign_writer(file) as writer:
        writer.add_attachment(1, 1, "notes.txt", "text/plain", b"hello")
    assert Recording(file).slots == {}
