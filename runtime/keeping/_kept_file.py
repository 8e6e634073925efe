"""A file that has one record, the latest one written, whenever its process or its host ends.

It has four places. A record is written to one that has neither the latest record, nor the latest
one that is known to be on the disk, nor the one that a thread is just bringing there. So a process
that is killed while it writes leaves the record before, and a loss of power at least the one that
was on the disk: no more than `SYNC_S` seconds older. A place that was not written to its end has a
wrong checksum, and counts as empty.

Writing is one system call into the cache of the kernel and never waits for the disk: records may
come a hundred times a second, and a turn of a machine stands behind each.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from struct import Struct
from typing import Final
from zlib import crc32

from llfsm.runtime.engine.errors import KeepError
from llfsm.whiteboard.board_files import lock, open_own, sync_folder
from llfsm.whiteboard.errors import BoardPermissionError

SYNC_S: Final = 1.0
"""The longest time in which what was written is not yet brought to the disk."""

_HEAD = Struct("<8sQ")  # the magic bytes, and the size of a place
_MAGIC = b"LLKEEP1\n"
_RECORD = Struct("<QQI")  # number from 1, length, checksum of these two and the bytes that follow
_CHECKED = Struct("<QQ")
_PLACES = 4
_LEAST = 4096 - _RECORD.size  # bytes that a place has room for


class KeptFile:
    """The file at `path`, locked until it is closed; `latest` is its record, None if it is new.

    Raise `KeepError` if another process has locked it, or it is damaged or no such file.
    """

    def __init__(self, path: Path):
        self.path = path
        self._file, self._size, self._number = -1, 0, 0
        self._newest = self._synced = self._syncing = -1  # places
        self._choosing = threading.Lock()
        self._written, self._closed = threading.Event(), threading.Event()
        self._thread: threading.Thread | None = None  # from the first record on
        self._failure: OSError | None = None
        self._is_gone = False  # as somebody has removed it
        self.latest: bytes | None = None
        try:
            self._file = self._open()
            if self._file >= 0:
                self.latest = self._read()
        except BaseException as error:
            self.close()
            if isinstance(error, OSError | BoardPermissionError):
                raise self._failed("cannot be read", error) from None
            raise

    def write(self, record: bytes) -> None:
        """Let `record` be the latest; raise `KeepError` if that is impossible."""
        if self._failure is not None:
            raise self._failed("cannot be written", self._failure)
        self._number += 1
        self.latest = record
        try:
            if self._file < 0 or self._is_gone or len(record) > self._size - _RECORD.size:
                self._make(record)
                return
            with self._choosing:
                used = {self._newest, self._synced, self._syncing}
                place = next(place for place in range(_PLACES) if place not in used)
                data = _packed(self._number, record)
                if os.pwrite(self._file, data, self._offset(place)) != len(data):
                    raise OSError("a part of it was not written")
                self._newest = place
        except OSError as error:
            raise self._failed("cannot be written", error) from None
        if self._thread is None:
            self._thread = threading.Thread(target=self._sync, name="kept file", daemon=True)
            self._thread.start()
        self._written.set()

    def close(self) -> None:
        """Bring the latest record to the disk, and release the file."""
        self._closed.set()
        self._written.set()
        if self._thread is not None:
            self._thread.join()
        if self._file >= 0:
            os.close(self._file)
            self._file = -1

    def _open(self) -> int:
        """Open and lock the file; return -1 if there is none."""
        while True:
            try:
                file = open_own(self.path)
            except FileNotFoundError:
                return -1
            if not lock(file):
                os.close(file)
                raise KeepError(
                    f"{self.path}: another process keeps its machines there; choose another file"
                )
            with suppress(FileNotFoundError):
                if os.path.samestat(os.fstat(file), os.stat(self.path)):
                    return file
            os.close(file)  # another one has its name since it was opened

    def _read(self) -> bytes:
        """Find the latest record, and its place."""
        head = os.pread(self._file, _HEAD.size, 0)
        magic, size = _HEAD.unpack(head) if len(head) == _HEAD.size else (b"", 0)
        fits = os.fstat(self._file).st_size >= _HEAD.size + _PLACES * size
        if magic != _MAGIC or size <= _RECORD.size or not fits:
            raise self._damaged()
        self._size = size
        number, place, record = max(self._records(), default=(0, 0, b""))
        if not number:
            raise self._damaged()
        self._number, self._newest = number, place
        return record

    def _records(self) -> Iterator[tuple[int, int, bytes]]:
        """Yield number, place and bytes of each record that was written to its end."""
        for place in range(_PLACES):
            data = os.pread(self._file, self._size, self._offset(place))
            number, length, checksum = _RECORD.unpack_from(data)
            record = data[_RECORD.size : _RECORD.size + length]
            if number and len(record) == length and checksum == _checksum(number, record):
                yield number, place, record

    def _make(self, record: bytes) -> None:
        """Make a file with places that `record` fits into; it takes the place of the one before."""
        size = max(_LEAST, 2 * len(record)) + _RECORD.size
        new = self.path.with_name(f"{self.path.name}.new")
        file = open_own(new, os.O_CREAT)
        try:
            if not lock(file):
                raise BlockingIOError("another process is making it")
            os.truncate(file, 0)
            data = _HEAD.pack(_MAGIC, size) + _packed(self._number, record)
            with open(file, "wb", closefd=False) as written:
                written.write(data.ljust(_HEAD.size + _PLACES * size, b"\0"))
            os.fsync(file)
            if (self._file < 0 or self._is_gone) and self.path.exists():
                raise FileExistsError("another process has just made it")
            os.replace(new, self.path)
        except BaseException:
            os.close(file)
            raise
        with self._choosing:
            before, self._file, self._size = self._file, file, size
            self._newest = self._synced = 0
            self._is_gone = False
            if before >= 0 and self._syncing < 0:
                os.close(before)  # else by the thread that uses it
            self._syncing = -1
        sync_folder(self.path.parent)

    def _sync(self) -> None:
        """Bring what was written to the disk, once in `SYNC_S` at most."""
        is_closed = False
        while not is_closed:
            self._written.wait()
            is_closed = self._closed.wait(SYNC_S)
            self._written.clear()
            with self._choosing:
                file, self._syncing = self._file, self._newest
            try:
                os.fsync(file)
                is_gone = not self.path.exists()
            except OSError as error:
                self._failure, is_gone = error, False
            with self._choosing:
                if file != self._file:
                    os.close(file)
                else:
                    self._synced, self._syncing = self._syncing, -1
                    self._is_gone = is_gone

    def _offset(self, place: int) -> int:
        return _HEAD.size + place * self._size

    def _damaged(self) -> KeepError:
        return KeepError(
            f"{self.path}: this is no file of kept machines, or it is damaged; to begin anew, "
            f"remove it"
        )

    def _failed(self, what: str, error: Exception) -> KeepError:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
        return KeepError(f"{self.path} {what}: {reason}")


def _packed(number: int, record: bytes) -> bytes:
    return _RECORD.pack(number, len(record), _checksum(number, record)) + record


def _checksum(number: int, record: bytes) -> int:
    return crc32(record, crc32(_CHECKED.pack(number, len(record))))
