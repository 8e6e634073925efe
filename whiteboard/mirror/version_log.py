"""The versions of a board's messages, kept in a file for the next daemon.

The file is beside the board's and mapped, so that it survives a killed daemon. A daemon holds its
lock while it runs. Each slot has a record of two entries, written alternately, so that one of them
is always intact.
"""

from __future__ import annotations

import mmap
import os
import secrets
import struct
from pathlib import Path
from stat import S_ISREG
from typing import Protocol
from zlib import crc32

from ..board_files import version_log_path
from ..errors import BoardMirroredError, BoardPermissionError, from_errno
from .merge import Version

__all__ = ["FileVersionLog", "NoVersionLog", "VersionLog"]

_HEAD = struct.Struct("<8sQQQ")  # magic, the board's device and inode, the host's id
_NAME = struct.Struct("<H254s")
_FIELDS = struct.Struct("<QQQQ")  # count, writer, time, host
_ENTRY = struct.Struct(f"<{_FIELDS.size}sQ")  # and their checksum
_RECORD = 256 + 2 * _ENTRY.size
_RECORDS = 4096
_START = 64
_SIZE = _START + _RECORDS * _RECORD
_MAGIC = b"LLMIRROR"
_HOSTS = 1 << 63  # ids of hosts


class VersionLog(Protocol):
    """Stores versions."""

    def note(self, slot: str, count: int, writer: int, version: Version) -> None:
        """Store the version of message number `count`, which process `writer` has added."""

    def recall(self, slot: str, count: int, writer: int) -> tuple[Version | None, Version | None]:
        """Return the version of that message, and the newest known one before it."""


class NoVersionLog:
    """Stores nothing, for a board that ends with its process."""

    def note(self, slot: str, count: int, writer: int, version: Version) -> None:
        """Do nothing."""

    def recall(self, slot: str, count: int, writer: int) -> tuple[Version | None, Version | None]:
        """Return no versions."""
        return None, None


class FileVersionLog:
    """The versions of a board in shared memory, locked by one daemon at a time.

    A damaged file is begun anew. Raise :class:`.BoardMirroredError` if another daemon holds the
    lock, and :class:`.BoardPermissionError` if the file belongs to another user, or is another kind
    of file: whoever owns it could set the versions.
    """

    def __init__(self, board: Path) -> None:
        import fcntl  # here, as Windows lacks it, where boards of other hosts can be read

        path = version_log_path(board)
        try:
            self._file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o600)
        except OSError as error:
            raise from_errno(error.errno or 0, str(path)) from error
        status = os.fstat(self._file)
        if status.st_uid != os.geteuid() or not S_ISREG(status.st_mode):
            os.close(self._file)
            raise BoardPermissionError(
                f"{path}: belongs to another user, or is not a regular file; remove it, or choose "
                f"another board name"
            )
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(self._file)
            raise BoardMirroredError(
                f"{board}: another daemon mirrors this whiteboard; see `llfsm whiteboard status`"
            ) from None
        os.posix_fallocate(self._file, 0, _SIZE)
        self._map = mmap.mmap(self._file, _SIZE)
        self._entries: dict[str, list[int]] = {}  # offsets, the older entry first
        found = os.stat(board)
        identity = found.st_dev, found.st_ino
        magic, *of_board, host = _HEAD.unpack_from(self._map)
        records = self._read_records()
        if records is None or (magic, *of_board) != (_MAGIC, *identity) or host >= _HOSTS:
            self._map[:] = bytes(_SIZE)  # of a removed board, or damaged
            records, host = {}, secrets.randbelow(_HOSTS)
            _HEAD.pack_into(self._map, 0, _MAGIC, *identity, host)
        self._records = records
        self.host: int = host

    def _read_records(self) -> dict[str, int] | None:
        """Return the offset of each slot's record; None if the file is damaged."""
        records: dict[str, int] = {}
        for record in range(_START, _SIZE, _RECORD):
            length, name = _NAME.unpack_from(self._map, record)
            if not length:
                break
            try:
                records[name[:length].decode()] = record
            except UnicodeDecodeError:
                return None
        return records

    def note(self, slot: str, count: int, writer: int, version: Version) -> None:
        """Store the version of message number `count`, which process `writer` has added."""
        entries = self._entries.get(slot) or self._find(slot)
        fields = _FIELDS.pack(count, writer, version.time, version.host)
        _ENTRY.pack_into(self._map, entries[0], fields, crc32(fields))
        entries.reverse()

    def _find(self, slot: str) -> list[int]:
        """Return the offsets of a slot's entries, the older one first."""
        record = self._records.get(slot) or self._make(slot)
        entries = sorted(_offsets(record), key=lambda offset: self._read(offset)[0])
        self._entries[slot] = entries
        return entries

    def _make(self, slot: str) -> int:
        record = self._records[slot] = _START + len(self._records) * _RECORD
        name = slot.encode()
        _NAME.pack_into(self._map, record, len(name), name)
        return record

    def _read(self, offset: int) -> tuple[int, int, int, int]:
        """Return an entry; zeros if there is none, or its writer was killed while writing it."""
        fields, checksum = _ENTRY.unpack_from(self._map, offset)
        return _FIELDS.unpack(fields) if crc32(fields) == checksum else (0, 0, 0, 0)

    def recall(self, slot: str, count: int, writer: int) -> tuple[Version | None, Version | None]:
        """Return the version of that message, and the newest known one before it."""
        record = self._records.get(slot)
        if record is None:
            return None, None
        entries = [self._read(offset) for offset in _offsets(record)]
        exact = [Version(t, h) for c, w, t, h in entries if (c, w) == (count, writer)]
        before = [Version(t, h) for c, _, t, h in entries if 0 < c < count]
        return max(exact, default=None), max(before, default=None)

    def close(self) -> None:
        """Release the lock; the file stays."""
        self._map.close()
        os.close(self._file)


def _offsets(record: int) -> list[int]:
    return [record + 256, record + 256 + _ENTRY.size]
