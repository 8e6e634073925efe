"""What we assume of the mcap library beyond what it documents: a test for each assumption."""

from __future__ import annotations

import struct
import tomllib
import zlib
from importlib.metadata import version
from io import BytesIO
from pathlib import Path

import pytest
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.reader import FOOTER_SIZE, SeekingReader
from mcap.records import Attachment, Channel, Chunk, Metadata, Schema
from mcap.stream_reader import MAGIC_SIZE, read_magic
from mcap.writer import Writer

from llfsm.bridges.recording.mcap_file import unpacked

HEAD = struct.Struct("<BQ")
PYPROJECT = Path(__file__).parents[3] / "pyproject.toml"


@pytest.fixture
def data() -> bytes:
    """A file with two chunks, each of one message, metadata and an attachment."""
    file = BytesIO()
    writer = Writer(file)
    writer.start(profile="llfsm")
    schema = writer.register_schema("S", "jsonschema", b"{}")
    channel = writer.register_channel("topic", "json", schema, {"key": "value"})
    writer.add_message(channel, 11, b"first", 1, 100)
    writer.flush()
    writer.add_message(channel, 12, b"second", 2, 101)
    writer.add_metadata("about", {"board": "test"})
    writer.add_attachment(5, 6, "name", "text/plain", b"attached")
    writer.finish()
    return file.getvalue()


def records(data: bytes, kind: Opcode) -> list[tuple[int, bytes]]:
    """Return the offset and body of each record of that kind."""
    found, at = [], MAGIC_SIZE
    while at < len(data) - MAGIC_SIZE:
        opcode, length = HEAD.unpack_from(data, at)
        if opcode == kind:
            found.append((at, data[at + HEAD.size : at + HEAD.size + length]))
        at += HEAD.size + length
    return found


def test_the_installed_version_is_one_that_these_tests_were_written_for() -> None:
    extras = tomllib.loads(PYPROJECT.read_text())["project"]["optional-dependencies"]
    assert "mcap>=1.6,<1.7" in extras["record"]
    found = version("mcap")
    assert found.startswith("1.6."), (
        f"mcap {found} is newer than pyproject.toml allows: if all tests of this file pass, "
        f"raise the bound there and here"
    )


def test_a_file_begins_with_a_magic_number(data: bytes) -> None:
    assert read_magic(ReadDataStream(BytesIO(data)))
    with pytest.raises(Exception, match="magic"):
        read_magic(ReadDataStream(BytesIO(b"PK" + bytes(MAGIC_SIZE))))


def test_each_record_reads_itself_from_a_stream_at_its_body(data: bytes) -> None:
    def read(kind: Opcode, record: type) -> object:
        (_, body), *_ = records(data, kind)
        return record.read(ReadDataStream(BytesIO(body)))  # type: ignore[attr-defined]

    about = read(Opcode.METADATA, Metadata)
    assert isinstance(about, Metadata)
    assert (about.name, about.metadata) == ("about", {"board": "test"})
    attached = read(Opcode.ATTACHMENT, Attachment)
    assert isinstance(attached, Attachment)
    assert (attached.create_time, attached.log_time, attached.data) == (5, 6, b"attached")
    channel = read(Opcode.CHANNEL, Channel)  # of the summary
    assert isinstance(channel, Channel)
    assert (channel.topic, channel.metadata) == ("topic", {"key": "value"})
    schema = read(Opcode.SCHEMA, Schema)
    assert isinstance(schema, Schema)
    assert (schema.id, schema.name, schema.data) == (channel.schema_id, "S", b"{}")


def test_a_flush_ends_a_chunk_and_metadata_and_attachments_are_in_none(data: bytes) -> None:
    assert len(records(data, Opcode.CHUNK)) == 2
    assert len(records(data, Opcode.METADATA)) == len(records(data, Opcode.ATTACHMENT)) == 1


def test_a_chunk_begins_with_its_times_and_holds_whole_records(data: bytes) -> None:
    (_, body), _ = records(data, Opcode.CHUNK)
    assert struct.unpack_from("<QQ", body) == (11, 11)
    chunk = Chunk.read(ReadDataStream(BytesIO(body)))
    inside, kinds, at = unpacked(chunk), [], 0
    while at < len(inside):
        kind, size = HEAD.unpack_from(inside, at)
        kinds.append(kind)
        at += HEAD.size + size
    assert kinds == [Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE]
    message = inside[-size:]
    assert struct.unpack_from("<HIQQ", message) == (1, 100, 11, 1)
    assert message[struct.calcsize("<HIQQ") :] == b"first"


def test_a_chunk_is_followed_by_an_index_for_each_channel(data: bytes) -> None:
    after = [
        HEAD.unpack_from(data, offset + HEAD.size + len(body))[0]
        for offset, body in records(data, Opcode.CHUNK)
    ]
    assert after == [Opcode.MESSAGE_INDEX] * 2
    assert [
        struct.unpack_from("<H", body)[0] for _, body in records(data, Opcode.MESSAGE_INDEX)
    ] == [
        1,
        1,
    ]


def test_the_summary_names_chunks_metadata_and_attachments_by_their_places(data: bytes) -> None:
    summary = SeekingReader(BytesIO(data)).get_summary()
    assert summary is not None
    chunks = [offset for offset, _ in records(data, Opcode.CHUNK)]
    assert [each.chunk_start_offset for each in summary.chunk_indexes] == chunks
    assert [each.message_start_time for each in summary.chunk_indexes] == [11, 12]
    assert [each.message_end_time for each in summary.chunk_indexes] == [11, 12]
    assert [[*each.message_index_offsets] for each in summary.chunk_indexes] == [[1], [1]]
    (metadata,) = records(data, Opcode.METADATA)
    assert [each.offset for each in summary.metadata_indexes] == [metadata[0]]
    (attachment,) = records(data, Opcode.ATTACHMENT)
    assert [each.offset for each in summary.attachment_indexes] == [attachment[0]]
    assert {each.topic for each in summary.channels.values()} == {"topic"}
    assert {each.name for each in summary.schemas.values()} == {"S"}


def test_the_footer_has_the_place_and_the_checksum_of_the_summary(data: bytes) -> None:
    footer = data[-FOOTER_SIZE - MAGIC_SIZE : -MAGIC_SIZE]
    kind, length = HEAD.unpack_from(footer)
    assert (kind, HEAD.size + length) == (Opcode.FOOTER, FOOTER_SIZE)
    start, _, checksum = struct.unpack_from("<QQI", footer, HEAD.size)
    assert zlib.crc32(data[start : -MAGIC_SIZE - 4]) == checksum


def test_between_the_chunks_and_the_summary_is_an_end(data: bytes) -> None:
    ((offset, _),) = records(data, Opcode.DATA_END)
    assert offset > records(data, Opcode.CHUNK)[-1][0]
