"""A board whose messages have versions, to which the merge rule is applied."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from enum import Enum, auto
from typing import Any

import msgspec

from ..board import Board, BoundSlot
from ..errors import MessageTypeError, SlotError, SlotTypeError
from ..message import Message, type_from_schema
from ..schema import differences
from ..slots import Slot
from .batches import Declaration, Value
from .merge import Version, succeed
from .refusals import Refused
from .version_log import VersionLog

__all__ = ["Cell", "Outcome", "Store"]


class Outcome(Enum):
    """What happened to a message of another host."""

    ENTERED = auto()
    KNOWN = auto()
    OLDER = auto()


class Cell:
    """A slot of the board, with the version of its message number `count`."""

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
        """Return whether a message was added since `count`."""
        return self.bound.count != self.count


class Store:
    """A board whose messages have versions. Hold `lock` to use it; anyone may add to the board.

    Args:
        board: of any kind.
        host: the id of this host.
        wall_ns: converts the stamp of a message into nanoseconds since 1970.
        versions: the known versions of the board's messages.
        horizon_ns: returns the latest time that a version may have now; a message whose version
            has a later one gets a new version.

    """

    def __init__(
        self,
        board: Board,
        host: int,
        wall_ns: Callable[[int], int],
        versions: VersionLog,
        horizon_ns: Callable[[], int],
    ) -> None:
        self.lock = threading.Lock()
        self.board = board
        self.host = host
        self.news: dict[str, None] = {}
        """Slots in which a message of this host was found, in that order; cleared by the caller."""
        self._wall_ns = wall_ns
        self._horizon_ns = horizon_ns
        self._versions = versions
        self._pid = os.getpid()
        self._cells: dict[str, Cell] = {}
        self._pending: list[tuple[str, int, int, Version]] = []

    def cell(self, name: str) -> Cell:
        """Return a slot that is on the board; raise `Refused` if its record is unusable."""
        cell = self._cells.get(name)
        if cell is None:
            try:
                slot = self.board.find(name)
                cell = self._cells[name] = Cell(slot, self.board.publisher(slot))
            except (SlotError, MessageTypeError) as error:  # some process has written nonsense
                raise Refused(f"slot {name!r} cannot be used: {error}") from error
        return cell

    def latest(self, cell: Cell) -> Value | None:
        """Return the latest message of a slot, or None before the first.

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
        """Return whether a version is not too far ahead of the clock."""
        return version is None or version.time <= self._horizon_ns()

    def _settle(self, cell: Cell, count: int, stamp_ns: int, writer: int) -> Version:
        """Return the version of message number `count`; assign one if it has no credible one."""
        before, known, name = cell.version, None, cell.slot.name
        if before is None:
            known, before = self._versions.recall(name, count, writer)
            known = known if self._is_credible(known) else None
        elif count == cell.count and self._is_credible(before):
            return before
        if known is None:
            wall_ns = self._wall_ns(stamp_ns)
            if before is not None and before.time >= wall_ns and not self._is_credible(before):
                before = None
            known = succeed(before, wall_ns, self.host)
        self._pending.append((name, count, writer, known))
        cell.version, cell.count = known, count
        if known.host == self.host:
            self.news[name] = None
        return known

    def note(self) -> None:
        """Store the versions assigned here, for the next daemon.

        It is enough to do so after the messages were sent: if a daemon is killed before, the next
        one assigns the same versions again, from the same stamps.
        """
        for assigned in self._pending:
            self._versions.note(*assigned)
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
        """Return the declaration of a slot that is on the board."""
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
            self._versions.note(value.slot, cell.count + 1, self._pid, version)
            count = cell.bound.add_after(message, cell.count)
            if count:
                cell.count, cell.version = count, version
                return Outcome.ENTERED

    def _decode(self, cell: Cell, payload: bytes) -> Message:
        try:
            message: Message = cell.decode(payload)
        except (msgspec.DecodeError, ValueError, TypeError, RecursionError) as error:
            what = f"slot {cell.slot.name!r}: the sender's data is not a {cell.slot.type_name}"
            raise Refused(f"{what}: {error}") from error
        return message
