"""A file in which the latest messages of chosen slots outlive all hosts of a board.

The file is written anew as a whole and then takes the place of the previous one, so that a daemon
that is killed, or loses power, leaves one of the two. Its messages carry their versions: a restored
one is as old as it was, and replaces none that is newer.

A daemon locks its file. The lock is taken before the file has its name, so there is no moment at
which another daemon could have it.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from concurrent.futures import Future, ThreadPoolExecutor, wait
from pathlib import Path
from typing import NamedTuple, TypeAlias
from zlib import crc32

import msgspec

from llfsm.whiteboard.board_files import lock, open_own, sync_folder
from llfsm.whiteboard.errors import (
    BoardCorruptError,
    BoardError,
    BoardMirroredError,
    WhiteboardError,
)
from llfsm.whiteboard.mirror.batches import Declaration, Value
from llfsm.whiteboard.mirror.quotas import Refused
from llfsm.whiteboard.mirror.settings import KeepSettings, matcher
from llfsm.whiteboard.mirror.store import Store
from llfsm.whiteboard.slot_names import is_own

_MAGIC = b"LLKEPT1\n"
_CHECKSUM = 4  # bytes after it
Refuse: TypeAlias = Callable[[str, str], object]
"""Counts a refusal under its kind, the first argument; logs the reason, the second, once."""

_PAUSE_S = 1.0  # between two writes


class Kept(NamedTuple):
    """A slot and its latest message."""

    declaration: Declaration
    value: Value


class _Content(NamedTuple):
    board: str
    slots: tuple[Kept, ...]


_CONTENT = msgspec.msgpack.Decoder(_Content)


class Keeper:
    """Keeps messages of the board named, for one thread; another one of its own writes the file.

    Raise :class:`.BoardCorruptError` for a damaged file, :class:`.BoardMirroredError` if another
    daemon keeps messages in it, :class:`.BoardPermissionError` if it belongs to another user, or is
    another kind of file, and another :class:`.BoardError` if it cannot be read or written, or
    belongs to another board.
    """

    def __init__(self, settings: KeepSettings, board: str) -> None:
        self._path = Path(os.path.realpath(settings.file))
        self._board = board
        self._matches = matcher(settings.slots)
        self._slots: dict[str, Kept] = {}
        self._changed: set[str] = set()
        self._due_s = 0.0
        self._is_written = True
        self._file = -1
        try:
            self._open()
        except OSError as error:
            is_there = error.filename and os.path.lexists(error.filename)
            which = error.filename if is_there else self._path
            raise BoardError(f"{which}: {error.strerror}; messages cannot be kept") from error
        self._writer = ThreadPoolExecutor(1, "keeper")
        self._writing: Future[None] | None = None

    def _open(self) -> None:
        """Lock the file and read it; make one if there is none."""
        try:
            self._file = open_own(self._path)
        except FileNotFoundError:
            self._replace()
            return
        try:
            self._lock(self._file)
            os.fchmod(self._file, 0o600)
            if not os.path.samestat(os.fstat(self._file), os.stat(self._path)):
                raise self._is_kept()  # another daemon has just replaced it
            self._slots = {kept.value.slot: kept for kept in self._read().slots}
        except BaseException:
            os.close(self._file)
            raise

    def _read(self) -> _Content:
        data = self._path.read_bytes()
        start = len(_MAGIC) + _CHECKSUM
        checksum, packed = data[len(_MAGIC) : start], data[start:]
        if not data.startswith(_MAGIC) or checksum != _checksum(packed):
            raise BoardCorruptError(
                f"{self._path}: damaged, or not a file of kept messages; move it elsewhere, and "
                f"the daemon begins a new one"
            )
        content = _CONTENT.decode(packed)
        if content.board != self._board:
            raise BoardError(
                f"{self._path}: keeps messages of the board {content.board!r}, and this one is "
                f"{self._board!r}; choose another file"
            )
        return content

    def restore(self, store: Store, refuse: Refuse) -> None:
        """Add the file's messages to a board where it has none newer; report those that fail."""
        for name, kept in self._slots.items():
            try:
                store.declare(kept.declaration)
                cell = store.cell(name)
                if cell.kind != kept.value.kind:
                    raise Refused(store.clash(cell, kept.declaration))
                store.enter(cell, kept.value)
            except (Refused, WhiteboardError) as error:
                refuse(f"from {self._path}", str(error))

    def follow(self, changed: Iterable[str], store: Store, now_s: float, refuse: Refuse) -> None:
        """Keep the slots that have changed, now or soon: it writes once a second at most."""
        # llfsm's own slots end with their processes.
        self._changed.update(s for s in changed if self._matches(s) and not is_own(s))
        if now_s >= self._due_s and (self._writing is None or self._writing.done()):
            self._report(refuse)
            self._take(store)
            if not self._is_written:
                self._due_s = now_s + _PAUSE_S
                self._is_written = True
                self._writing = self._writer.submit(self._replace)

    def finish(self, store: Store, refuse: Refuse) -> None:
        """Keep all that has changed, and wait until it is written."""
        self.wait_written()
        self.follow((), store, self._due_s, refuse)
        self.wait_written()
        self._report(refuse)

    def wait_written(self) -> None:
        """Wait for the end of the write that has begun, if one has."""
        if self._writing is not None:
            wait([self._writing])

    def _take(self, store: Store) -> None:
        """Take the latest messages of the slots that have changed, with their versions."""
        with store.lock:
            for name in self._changed:
                try:
                    cell = store.cell(name)
                except Refused:  # counted where it is sent
                    continue
                value, before = store.latest(cell), self._slots.get(name)
                if value is not None and (before is None or before.value.version != value.version):
                    # In a copy, as the other one may just be written.
                    self._slots = {**self._slots, name: Kept(store.declaration(cell), value)}
                    self._is_written = False
            store.note()
        self._changed.clear()

    def _report(self, refuse: Refuse) -> None:
        """Report a write that has failed; it is tried again."""
        error = None if self._writing is None else self._writing.exception()
        if error is not None:
            self._is_written = False
            refuse(f"{self._path} cannot be written", str(error))
        self._writing = None

    def _replace(self) -> None:
        """Write the file, and put it in place of the previous one."""
        packed = msgspec.msgpack.encode(_Content(self._board, tuple(self._slots.values())))
        new = self._path.with_name(f"{self._path.name}.new")
        file = open_own(new, os.O_CREAT)
        try:
            self._lock(file)
            os.fchmod(file, 0o600)  # as the board's: it has the same messages
            os.truncate(file, 0)
            with open(file, "wb", closefd=False) as written:
                written.write(_MAGIC + _checksum(packed) + packed)
            os.fsync(file)
            os.replace(new, self._path)
        except BaseException:
            os.close(file)
            raise
        if self._file >= 0:
            os.close(self._file)
        self._file = file
        sync_folder(self._path.parent)

    def _lock(self, file: int) -> None:
        if not lock(file):
            raise self._is_kept()

    def _is_kept(self) -> BoardMirroredError:
        return BoardMirroredError(
            f"{self._path}: another daemon keeps messages in this file; choose another one"
        )

    def close(self) -> None:
        """Wait for a write that has begun, and release the file."""
        self._writer.shutdown()
        os.close(self._file)


def _checksum(packed: bytes) -> bytes:
    return crc32(packed).to_bytes(_CHECKSUM, "little")
