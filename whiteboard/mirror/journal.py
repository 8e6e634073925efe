"""What the daemon of a board knows, kept for the one after it: the versions of the slots' messages.

A file beside the board's, mapped, so that it outlives a killed daemon. Its lock tells that a daemon
is at work. Each slot has a record of two entries, written in turns, so that one is always whole.
"""

from __future__ import annotations

import fcntl
import mmap
import os
import secrets
import struct
from pathlib import Path
from typing import Protocol
from zlib import crc32

from ..errors import BoardMirroredError, from_errno
from ..shared import journal_path
from .merge import Version

__all__ = ["FileJournal", "Journal", "NoJournal"]

_HEAD = struct.Struct("<8sQQQ")  # magic, the board's device and inode, the host's id
_NAME = struct.Struct("<H254s")
_FIELDS = struct.Struct("<QQQQ")  # count, writer, time, host
_ENTRY = struct.Struct(f"<{_FIELDS.size}sQ")  # and their checksum
_RECORD = 256 + 2 * _ENTRY.size
_RECORDS = 4096
_START = 64
_SIZE = _START + _RECORDS * _RECORD
_MAGIC = b"LLMIRROR"


class Journal(Protocol):
    """Where versions are kept."""

    def note(self, slot: str, count: int, writer: int, version: Version) -> None:
        """Keep the version of the message of that number which that process has added."""

    def recall(self, slot: str, count: int, writer: int) -> tuple[Version | None, Version | None]:
        """Return the version of that message, and of the newest one before it that is known."""


class NoJournal:
    """For a board that ends with its process."""

    def note(self, slot: str, count: int, writer: int, version: Version) -> None:
        """Forget it."""

    def recall(self, slot: str, count: int, writer: int) -> tuple[Version | None, Version | None]:
        """Know of nothing."""
        return None, None


class FileJournal:
    """The journal of a board in shared memory, held by one daemon at a time.

    Raise :class:`.BoardMirroredError` if another one holds it.
    """

    def __init__(self, board: Path) -> None:
        path = journal_path(board)
        try:
            self._file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o600)
        except OSError as error:
            raise from_errno(error.errno or 0, str(path)) from error
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(self._file)
            raise BoardMirroredError(
                f"{board}: another daemon mirrors this whiteboard; see `llfsm whiteboard status`"
            ) from None
        os.posix_fallocate(self._file, 0, _SIZE)
        self._map = mmap.mmap(self._file, _SIZE)
        self._places: dict[str, int] = {}
        self._next: dict[str, list[int]] = {}
        found = os.stat(board)
        magic, *of_board, host = _HEAD.unpack_from(self._map)
        if magic != _MAGIC or of_board != [found.st_dev, found.st_ino]:  # of a board that is gone
            self._map[:] = bytes(_SIZE)
            host = secrets.randbits(63)
            _HEAD.pack_into(self._map, 0, _MAGIC, found.st_dev, found.st_ino, host)
        self.host: int = host
        for place in range(_START, _SIZE, _RECORD):
            length, name = _NAME.unpack_from(self._map, place)
            if not length:
                break
            self._places[name[:length].decode()] = place

    def note(self, slot: str, count: int, writer: int, version: Version) -> None:
        """Keep the version of the message of that number which that process has added."""
        places = self._next.get(slot) or self._find(slot)
        fields = _FIELDS.pack(count, writer, version.time, version.host)
        _ENTRY.pack_into(self._map, places[0], fields, crc32(fields))
        places.reverse()

    def _find(self, slot: str) -> list[int]:
        """Return where the entries of a slot are, the older one first."""
        place = self._places.get(slot) or self._make(slot)
        entries = sorted(range(2), key=lambda index: self._entry(place, index)[0])
        places = self._next[slot] = [_at(place, index) for index in entries]
        return places

    def _make(self, slot: str) -> int:
        place = self._places[slot] = _START + len(self._places) * _RECORD
        name = slot.encode()
        _NAME.pack_into(self._map, place, len(name), name)
        return place

    def _entry(self, place: int, index: int) -> tuple[int, int, int, int]:
        """Return an entry; of zeros if there is none, or its writer was killed at it."""
        fields, checksum = _ENTRY.unpack_from(self._map, _at(place, index))
        return _FIELDS.unpack(fields) if crc32(fields) == checksum else (0, 0, 0, 0)

    def recall(self, slot: str, count: int, writer: int) -> tuple[Version | None, Version | None]:
        """Return the version of that message, and of the newest one before it that is known."""
        place = self._places.get(slot)
        if place is None:
            return None, None
        entries = [self._entry(place, index) for index in range(2)]
        exact = [Version(t, h) for c, w, t, h in entries if (c, w) == (count, writer)]
        before = [Version(t, h) for c, _, t, h in entries if 0 < c < count]
        return max(exact, default=None), max(before, default=None)

    def close(self) -> None:
        """Let go of it; what it says stays."""
        self._map.close()
        os.close(self._file)


def _at(place: int, index: int) -> int:
    return place + 256 + index * _ENTRY.size
