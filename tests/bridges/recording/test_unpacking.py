"""What a recording unpacks to is bounded, whatever the file claims."""

from __future__ import annotations

import logging
import struct
import tracemalloc
import zlib
from pathlib import Path

import lz4.frame
import pytest
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.records import Chunk
from mcap.writer import CompressionType, Writer

from llfsm.bridges.recording.mcap_file import LARGEST_CHUNK, McapFile, unpacked
from llfsm.bridges.recording.reader import Recording
from llfsm.bridges.recording.writer import ABOUT

PACK = {"": bytes, "lz4": lz4.frame.compress, "zstd": zstandard.compress}


def chunk(compression: str, data: bytes, **changes: object) -> Chunk:
    fields = {
        "compression": compression,
        "data": PACK[compression](data),
        "message_start_time": 0,
        "message_end_time": 0,
        "uncompressed_crc": zlib.crc32(data),
        "uncompressed_size": len(data),
    }
    return Chunk(**{**fields, **changes})


@pytest.mark.parametrize("compression", PACK)
@pytest.mark.parametrize("data", [b"", b"records", bytes(3 << 20)])
def test_a_chunk_is_unpacked(compression: str, data: bytes) -> None:
    assert unpacked(chunk(compression, data)) == data


@pytest.mark.parametrize("compression", PACK)
@pytest.mark.parametrize("claimed", [0, 6, 8, LARGEST_CHUNK, LARGEST_CHUNK + 1, 1 << 63])
def test_another_size_than_is_claimed_is_an_error(compression: str, claimed: int) -> None:
    with pytest.raises(ValueError, match="unpack"):
        unpacked(chunk(compression, b"records", uncompressed_size=claimed))


@pytest.mark.parametrize("compression", PACK)
def test_a_wrong_checksum_is_an_error_and_none_is_not(compression: str) -> None:
    with pytest.raises(ValueError, match="checksum"):
        unpacked(chunk(compression, b"records", uncompressed_crc=1))
    assert unpacked(chunk(compression, b"records", uncompressed_crc=0)) == b"records"


def test_an_unknown_compression_is_an_error() -> None:
    found = chunk("", b"records")
    found.compression = "br"
    with pytest.raises(ValueError, match="'br' is unknown"):
        unpacked(found)


@pytest.mark.parametrize("compression", ["lz4", "zstd"])
@pytest.mark.parametrize("claimed", [1 << 10, 1 << 20, 1 << 40])
def test_what_unpacks_to_more_takes_no_memory(compression: str, claimed: int) -> None:
    bomb = chunk(compression, bytes(32 << 20), uncompressed_size=claimed)
    assert len(bomb.data) < 1 << 18
    tracemalloc.start()
    try:
        with pytest.raises(ValueError, match="unpack"):
            unpacked(bomb)
        assert tracemalloc.get_traced_memory()[1] < 4 << 20
    finally:
        tracemalloc.stop()


def record(kind: int, build: bytes) -> bytes:
    return struct.pack("<BQ", kind, len(build)) + build


def body(found: Chunk) -> bytes:
    builder = RecordBuilder()
    found.write(builder)
    return builder.end()


@pytest.mark.parametrize("compression", ["lz4", "zstd"])
def test_a_file_that_unpacks_to_gigabytes_is_opened_without_them(
    file: Path, compression: str, caplog: pytest.LogCaptureFixture
) -> None:
    with file.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.NONE)
        writer.start(profile="llfsm")
        writer.add_metadata(ABOUT, {"offset_ns": "0", "begin_ns": "0"})
        bomb = body(chunk(compression, bytes(64 << 20), uncompressed_size=1 << 20))
        for _ in range(4):
            stream.write(bomb)
    tracemalloc.start()
    try:
        with caplog.at_level(logging.WARNING):
            assert [*Recording(file).messages()] == []
        assert tracemalloc.get_traced_memory()[1] < 16 << 20
    finally:
        tracemalloc.stop()
    assert "a part of it is damaged and left out" in caplog.text


def test_a_chunk_of_millions_of_messages_is_left_out(file: Path) -> None:
    message = record(5, struct.pack("<HIQQ", 1, 0, 0, 0))
    with file.open("wb") as stream:
        Writer(stream).start(profile="llfsm")
        stream.write(body(chunk("zstd", message * (1 << 19))))
    assert len(McapFile(file).chunks) == 1
    assert McapFile(file).messages(0) == {}


def test_a_record_that_is_longer_than_the_file_is_not_read(file: Path) -> None:
    with file.open("wb") as stream:
        Writer(stream).start(profile="llfsm")
        stream.write(struct.pack("<BQ", 6, 1 << 62))
    assert McapFile(file).chunks == []
