"""The attachment of each message: 33 bytes.

Sequence number and time in ns as 64 bits little-endian, the number 16, and 16 bytes that identify
the sender. A reply carries the sequence number and the sender of its request.
"""

from __future__ import annotations

from struct import Struct

from ..transport import MessageInfo

__all__ = ["GID_SIZE", "pack", "unpack"]

GID_SIZE = 16

_LAYOUT = Struct(f"<qqB{GID_SIZE}s")


def pack(sequence: int, time_ns: int, gid: bytes) -> bytes:
    """Return an attachment."""
    return _LAYOUT.pack(sequence, time_ns, GID_SIZE, gid)


def unpack(data: bytes) -> MessageInfo | None:
    """Return the metadata in an attachment, or None if the bytes are not one."""
    if len(data) != _LAYOUT.size:
        return None
    sequence, time_ns, size, gid = _LAYOUT.unpack(data)
    return MessageInfo(time_ns, sequence, gid) if size == GID_SIZE else None
