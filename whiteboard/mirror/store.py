"""A board whose messages have versions, to which the merge rule is applied.

Processes add to the board without knowing of versions. So a message gets its version when it is
found: from its stamp, the time of the add, and above the version before it (see :mod:`.batches`).
A cell knows the version of message number `count`; a message with a larger number was added by a
process here, and is news. Another host's message is added only if the number is still the one
whose version was compared, so an add of a process in between is compared as well, and none is lost
to an older one.

A version that is further ahead of the clock than the horizon counts as none, and the message gets a
new one: the clock may have been wrong when it was assigned, and has been set since.

A restarted daemon must know the versions of what is on the board, or old messages would seem new.
They are in a file beside the board's, mapped, so that it survives a killed daemon; a daemon holds
its lock while it runs. Each slot has a record of two entries with checksums, written alternately,
so that one of them is always intact. An entry names its message by number and writer: the version
of another host's message is stored before it is added, and if the daemon is killed in between, the
entry matches no message. A version assigned here may be stored late: from the same stamp, the next
daemon assigns the same one.
"""

from __future__ import annotations

import mmap
import os
import secrets
import struct
import threading
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from enum import Enum, auto
from pathlib import Path
from typing import Any
from zlib import crc32

import msgspec

from llfsm.whiteboard.board import Board, BoundSlot
from llfsm.whiteboard.board_files import lock, open_own, version_log_path
from llfsm.whiteboard.errors import (
    BoardMirroredError,
    MessageTypeError,
    SlotError,
    SlotNotFoundError,
    SlotTypeError,
    from_errno,
)
from llfsm.whiteboard.message import Message, type_from_schema
from llfsm.whiteboard.mirror.batches import Declaration, Value, Version, succeed
from llfsm.whiteboard.mirror.quotas import Gone, Refused
from llfsm.whiteboard.mirror.stand_ins import stand_ins, version_below
from llfsm.whiteboard.schema import differences
from llfsm.whiteboard.slots import Slot

_MAX_ENDED = 4096  # names that were given up


class Outcome(Enum):
    """The fate of another host's message: it is on the board now, was there before, or is older."""

    ENTERED = auto()
    KNOWN = auto()
    OLDER = auto()


class Cell:
    """A slot of the board with a handle of ours, and the version of its message number `count`."""

    __slots__ = ("bound", "capacity", "count", "decode", "encoded", "kind", "slot", "version")

    def __init__(self, slot: Slot[Any], bound: BoundSlot[Any]) -> None:
        self.slot = slot
        self.bound = bound
        self.encoded = bound.encoded
        self.decode = slot.decoder.decode
        self.kind = slot.fingerprint
        self.capacity = bound.capacity
        self.count = 0
        self.version: Version | None = None

    def has_news(self) -> bool:
        """Check that a message was added since number `count`."""
        return self.bound.count != self.count


@dataclass(eq=False)
class Store:
    """A board whose messages have versions. Hold `lock` to use it; anyone may add to the board.

    `wall_ns` converts the stamp of a message into nanoseconds since 1970. `horizon_ns` gives the
    latest time that a version may have now: a message with a later one gets a new version.
    """

    board: Board
    host: int
    wall_ns: Callable[[int], int]
    versions: VersionLog
    horizon_ns: Callable[[], int]

    def __post_init__(self) -> None:
        self.lock = threading.Lock()
        self.news: dict[str, None] = {}
        """Slots in which a message of this host was found, in that order; cleared by the caller."""
        self.standing_in: dict[str, Cell] = {}
        """The slots whose latest message stands in for one of another host, until that is heard."""
        self.ended: dict[str, Version] = {}
        """Names that were given up elsewhere: what is added later is newer, whatever the clocks."""
        self._pid = os.getpid()
        self._cells: dict[str, Cell] = {}
        self._pending: list[tuple[str, int, int, Version]] = []

    def cell(self, name: str) -> Cell:
        """Return a slot that is on the board.

        Raise `Gone` if it is not, and `Refused` if its record is unusable.
        """
        cell = self._cells.get(name)
        if cell is None:
            try:
                slot = self.board.find(name)
                cell = self._cells[name] = Cell(slot, self.board.publisher(slot, make=False))
            except SlotNotFoundError as error:
                raise Gone(str(error)) from error
            except (SlotError, MessageTypeError) as error:  # some process has written nonsense
                raise Refused(f"slot {name!r} cannot be used: {error}") from error
        return cell

    def note_end(self, name: str, version: Version) -> None:
        """Keep the version of a name's end, as an older message may still be on its way."""
        self.ended[name] = max(version, self.ended.pop(name, version))
        if len(self.ended) > _MAX_ENDED:
            del self.ended[next(iter(self.ended))]

    def forget(self, names: Iterable[str]) -> None:
        """Forget slots whose names were given up."""
        for name in names:
            self._cells.pop(name, None)
            self.standing_in.pop(name, None)

    def latest(self, cell: Cell) -> Value | None:
        """Return the latest message of a slot with its version, or None before the first.

        It is not validated here, because the receiver has to do that anyway.
        """
        latest = cell.encoded()
        if latest is None:
            return None
        payload, count, stamp_ns, writer = latest
        version = self._settle(cell, count, stamp_ns, writer)
        return Value(cell.slot.name, cell.kind, version, payload)

    def version(self, cell: Cell) -> Version | None:
        """Return the version of a slot's latest message, or None before the first."""
        if cell.has_news() or not self._is_credible(cell.version):
            latest = cell.encoded()
            if latest is not None:
                _, *added = latest
                self._settle(cell, *added)
            else:  # its name was given up: it begins anew
                cell.count = 0
        return cell.version

    def _is_credible(self, version: Version | None) -> bool:
        """Check that a version is not too far ahead of the clock."""
        return version is None or version.time <= self.horizon_ns()

    def _settle(self, cell: Cell, count: int, stamp_ns: int, writer: int) -> Version:
        """Return the version of message number `count`; assign one if it has no credible one."""
        before, known, name = cell.version, None, cell.slot.name
        if count != cell.count:
            self.standing_in.pop(name, None)
        if before is None:
            known, before = self.versions.recall(name, count, writer)
            before = before or self.ended.get(name)
            known = known if self._is_credible(known) else None
        elif count == cell.count and self._is_credible(before):
            return before
        replaced = before if known is None else known
        is_foreign = replaced is not None and replaced.host != self.host
        if is_foreign and (name, count) in stand_ins(self.board):
            self.standing_in[name] = cell
            known = replaced
        if known is None:
            wall_ns = self.wall_ns(stamp_ns)
            if before is not None and before.time >= wall_ns and not self._is_credible(before):
                before = None
            known = succeed(before, wall_ns, self.host)
        self._pending.append((name, count, writer, known))
        cell.version, cell.count = known, count
        if known.host == self.host:
            self.news[name] = None
        return known

    def stands_in(self, cell: Cell) -> bool:
        """Check that a slot's latest message stands in for one of another host."""
        name = cell.slot.name
        if name in self.standing_in and cell.has_news():
            self.version(cell)
        return name in self.standing_in

    def give_way(self) -> list[str]:
        """Let stand-ins that are not noted any more be older than what they replaced.

        Return their slots.
        """
        noted, found = stand_ins(self.board), []
        for name, cell in list(self.standing_in.items()):
            version, latest = self.version(cell), cell.encoded()
            if version is None or latest is None or not self.stands_in(cell):
                continue
            _, count, _, writer = latest
            if count == cell.count and (name, count) not in noted:
                cell.version = version_below(version)
                self._pending.append((name, count, writer, cell.version))
                del self.standing_in[name]
                found.append(name)
        return found

    def note(self) -> None:
        """Store the versions assigned here, for the next daemon.

        It is enough to do so after the messages were sent: if a daemon is killed before, the next
        one assigns the same versions again, from the same stamps.
        """
        for assigned in self._pending:
            self.versions.note(*assigned)
        self._pending.clear()

    def declare(self, declaration: Declaration) -> None:
        """Make a slot that is not on the board. Raise `Refused` if that fails."""
        try:
            kind = type_from_schema(declaration.schema)
            slot = Slot(declaration.slot, kind, declaration.capacity)
            cell = Cell(slot, self.board.publisher(slot))
        except SlotTypeError as error:  # a process made it since its name was looked for
            raise Refused(self.clash(self.cell(declaration.slot), declaration)) from error
        except Exception as error:  # another host may send any schema
            raise Refused(f"slot {declaration.slot!r} cannot be made: {error}") from error
        self._cells.setdefault(declaration.slot, cell)

    def declaration(self, cell: Cell) -> Declaration:
        """Declare a slot that is on the board, for other hosts."""
        return Declaration(cell.slot.name, cell.capacity, cell.slot.schema)

    def clash(self, cell: Cell, theirs: Declaration) -> str:
        """Describe how the sender's type of a slot differs from the board's."""
        ours = cell.slot
        try:
            how = "; ".join(differences(ours.schema, theirs.schema))
        except Exception:  # another host may send any schema
            how = "the sender's is not a message's schema"
        return (
            f"slot {theirs.slot!r} holds {ours.type_name} here, {theirs.schema.get('title')} at "
            f"the sender, called `ours` in: {how}"
        )

    def enter(self, cell: Cell, value: Value) -> Outcome:
        """Add a message of another host, unless the board's is as new or newer.

        If a process adds at the same moment, its message is compared as well. Raise `Refused` for a
        message of another type.
        """
        version, payload = value.version, value.payload
        message: Message | None = None
        while True:
            ours = cell.version  # if it is older, its own time does not matter
            if cell.bound.count != cell.count or (ours is not None and ours >= version):
                ours = self.version(cell)
                if ours is not None and ours >= version:
                    return Outcome.KNOWN if ours == version else Outcome.OLDER
            if message is None:
                message = self._decode(cell, payload)
            if self._pending:
                self.note()
            # Stored before the add: if the daemon is killed in between, the entry's number and
            # writer match no message.
            self.versions.note(value.slot, cell.count + 1, self._pid, version)
            count = cell.bound.add_after(message, cell.count)
            if count:
                cell.count, cell.version = count, version
                self.standing_in.pop(value.slot, None)
                return Outcome.ENTERED

    def _decode(self, cell: Cell, payload: bytes) -> Message:
        try:
            message: Message = cell.decode(payload)
        except (msgspec.DecodeError, ValueError, TypeError, RecursionError) as error:
            what = f"slot {cell.slot.name!r}: the sender's data is not a {cell.slot.type_name}"
            raise Refused(f"{what}: {error}") from error
        return message


# ---- Version logs ---------------------------------------------------------------------------


class VersionLog:
    """The versions of a board's messages for its next daemon; this stores none, as none follows."""

    def note(self, slot: str, count: int, writer: int, version: Version) -> None:
        """Store the version of message number `count`, which process `writer` has added."""

    def recall(self, slot: str, count: int, writer: int) -> tuple[Version | None, Version | None]:
        """Return the version of that message, and the newest known one before it."""
        return None, None


# The file: a head, and a record for each slot, of its name and two entries.
_HEAD = struct.Struct("<8sQQQ")  # magic, the board's device and inode, the host's id
_NAME = struct.Struct("<Bc254s")  # its length, its last byte if it has 255, and the others
_FIELDS = struct.Struct("<QQQQ")  # count, writer, time, host
_ENTRY = struct.Struct(f"<{_FIELDS.size}sQ")  # and their checksum
_RECORD = _NAME.size + 2 * _ENTRY.size
_RECORDS = 4096  # slots of a board
_START = 64
_SIZE = _START + _RECORDS * _RECORD
_MAGIC = b"LLMIRROR"
_HOSTS = 1 << 63  # ids of hosts


class FileVersionLog(VersionLog):
    """The versions of a board in shared memory, locked by one daemon at a time.

    It has room for as many slots as a board. When all of it is used, records of names that the
    board does not have any more, by `on_board`, serve others. A damaged file is begun anew. Raise
    :class:`.BoardMirroredError` if another daemon holds the lock, and
    :class:`.BoardPermissionError` if the file belongs to another user, or is another kind of file:
    whoever owns it could set the versions.
    """

    def __init__(self, board: Path, on_board: Callable[[], Iterable[str]] = tuple) -> None:
        self._on_board = on_board
        self._used = 0  # records with a name, or that had one
        self._free: list[int] = []  # those of names that are gone
        path = version_log_path(board)
        try:
            self._file = open_own(path, os.O_CREAT)
        except OSError as error:
            raise from_errno(error.errno or 0, str(path)) from error
        if not lock(self._file):
            os.close(self._file)
            raise BoardMirroredError(
                f"{board}: another daemon mirrors this whiteboard; see `llfsm whiteboard status`"
            )
        os.posix_fallocate(self._file, 0, _SIZE)
        self._map = mmap.mmap(self._file, _SIZE)
        self._entries: dict[str, list[int]] = {}  # offsets, the older entry first
        found = os.stat(board)
        identity = found.st_dev, found.st_ino
        magic, *of_board, host = _HEAD.unpack_from(self._map)
        records = self._read_records()
        if records is None or (magic, *of_board) != (_MAGIC, *identity) or host >= _HOSTS:
            self._map[:] = bytes(_SIZE)  # of a removed board, or damaged
            self._used, self._free = 0, []
            records, host = {}, secrets.randbelow(_HOSTS)
            _HEAD.pack_into(self._map, 0, _MAGIC, *identity, host)
        self._records = records
        self.host: int = host

    def _read_records(self) -> dict[str, int] | None:
        """Find the offset of each slot's record; None if the file is damaged."""
        records: dict[str, int] = {}
        for record in range(_START, _SIZE, _RECORD):
            length, last, raw = _NAME.unpack_from(self._map, record)
            if not length:
                break
            try:
                name = (raw + last)[:length].decode()
            except UnicodeDecodeError:
                return None
            self._used += 1
            if name in records:  # it was gone, and came again
                self._free.append(records[name])
            records[name] = record
        return records

    def note(self, slot: str, count: int, writer: int, version: Version) -> None:
        """Store the version of message number `count`, which process `writer` has added."""
        entries = self._entries.get(slot) or self._find(slot)
        fields = _FIELDS.pack(count, writer, version.time, version.host)
        _ENTRY.pack_into(self._map, entries[0], fields, crc32(fields))
        entries.reverse()

    def _find(self, slot: str) -> list[int]:
        """Find the offsets of a slot's entries, the older one first; make its record if needed."""
        record = self._records.get(slot) or self._make(slot)
        entries = sorted(_offsets(record), key=lambda offset: self._read(offset)[0])
        self._entries[slot] = entries
        return entries

    def _make(self, slot: str) -> int:
        if self._used < _RECORDS:
            record = _START + self._used * _RECORD
            self._used += 1
        else:
            record = self._free.pop() if self._free else self._reuse()
            self._map[record : record + _RECORD] = bytes(_RECORD)
        self._records[slot] = record
        name = slot.encode()
        _NAME.pack_into(self._map, record, len(name), name[254:] or b"\0", name)
        return record

    def _reuse(self) -> int:
        """Free the records of names that are gone, and return one; else that of the oldest name."""
        gone = self._records.keys() - {*self._on_board()} or {next(iter(self._records))}
        for name in gone:
            self._free.append(self._records.pop(name))
            self._entries.pop(name, None)
        return self._free.pop()

    def _read(self, offset: int) -> tuple[int, int, int, int]:
        """Read an entry: zeros if there is none, or a daemon was killed while writing it."""
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
    return [record + _NAME.size, record + _NAME.size + _ENTRY.size]
