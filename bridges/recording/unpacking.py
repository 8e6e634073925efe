"""A chunk's data, unpacked: never more than the chunk claims, and never more than a limit.

A file of a few kilobytes can unpack to gigabytes. The mcap library trusts what the compressed data
say of their own size.
"""

from __future__ import annotations

import zlib
from typing import Final

import zstandard
from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]
from mcap.records import Chunk

__all__ = ["LARGEST_CHUNK", "unpacked"]

LARGEST_CHUNK: Final = 64 << 20
"""Bytes. Those that llfsm records have one megabyte, or one message."""


def unpacked(chunk: Chunk) -> bytes:
    """Return the records in a chunk; raise an error of any kind if they are damaged."""
    size = chunk.uncompressed_size
    if size > LARGEST_CHUNK:
        raise ValueError(f"it unpacks to {size} bytes, the limit is {LARGEST_CHUNK}")
    if chunk.compression == "zstd":
        data = zstandard.ZstdDecompressor().stream_reader(chunk.data).read(size + 1)
    elif chunk.compression == "lz4":
        data = LZ4FrameDecompressor().decompress(chunk.data, size + 1)
    elif not chunk.compression:
        data = chunk.data
    else:
        raise ValueError(f"its compression {chunk.compression!r} is unknown")
    if len(data) != size:
        raise ValueError(f"it claims to unpack to {size} bytes, but does not")
    if chunk.uncompressed_crc not in (0, zlib.crc32(data)):
        raise ValueError("its checksum is wrong")
    return data
