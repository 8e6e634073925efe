"""A board whose messages have versions: what the merge rule is applied to."""

from __future__ import annotations

import os
from collections.abc import Callable
from enum import Enum, auto
from typing import Any

import msgspec

from ..board import Board, BoundSlot
from ..errors import MessageTypeError, SlotError
from ..message import Message
from ..schema import differences, type_from_schema
from ..slots import Slot
from .journal import Journal
from .merge import Version, succeed
from .wire import Declaration, Value

__all__ = ["Cell", "Outcome", "Refused", "Store"]


class Outcome(Enum):
    """What becomes of a message of another host."""

    ENTERED = auto()
    KNOWN = auto()
    OLDER = auto()


class Refused(Exception):  # noqa: N818  not for users: it is counted and reported
    """Tell why a message does not enter: what is reported, once."""


class Cell:
    """A slot of the board, with the version of its message of number `count`."""

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


class Store:
    """A board whose messages have versions. For one thread at a time, beside those that add.

    Args:
        board: any kind.
        host: the id of this host.
        wall_ns: turns the stamp of a message into nanoseconds since 1970.
        journal: what is known of the board already.

    """

    def __init__(
        self, board: Board, host: int, wall_ns: Callable[[int], int], journal: Journal
    ) -> None:
        self.board = board
        self.host = host
        self.news: dict[str, None] = {}
        """Slots in which a message of this host was found, in that order; for others to clear."""
        self._wall_ns = wall_ns
        self._journal = journal
        self._pid = os.getpid()
        self._cells: dict[str, Cell] = {}
        self._unnoted: list[tuple[str, int, int, Version]] = []

    def cell(self, name: str) -> Cell:
        """Return a slot that is on the board; raise `Refused` if nobody can use it."""
        cell = self._cells.get(name)
        if cell is None:
            try:
                slot = self.board.find(name)
                cell = self._cells[name] = Cell(slot, self.board[slot])
            except (SlotError, MessageTypeError) as error:  # what some process wrote of it
                raise Refused(f"slot {name!r} cannot be used: {error}") from error
        return cell

    def has(self, name: str) -> bool:
        """Tell whether the board has the slot."""
        return name in self._cells or any(info.name == name for info in self.board.slots())

    def latest(self, cell: Cell) -> Value | None:
        """Return the latest message of a slot, or None before the first.

        It is passed on as it is: who gets it has to check it anyway.
        """
        latest = cell.encoded()
        if latest is None:
            return None
        payload, count, stamp_ns, writer = latest
        version = cell.version
        if version is None or count != cell.count:
            version = self._settle(cell, count, stamp_ns, writer)
        return Value(cell.slot.name, cell.kind, version, payload)

    def version(self, cell: Cell) -> Version | None:
        """Return the version of a slot's latest message, or None before the first."""
        if cell.bound.count != cell.count and (latest := cell.encoded()) is not None:
            _, *added = latest
            self._settle(cell, *added)
        return cell.version

    def _settle(self, cell: Cell, count: int, stamp_ns: int, writer: int) -> Version:
        """Give a message that somebody here has added its version."""
        known, before, name = None, cell.version, cell.slot.name
        if before is None:
            known, before = self._journal.recall(name, count, writer)
        version = known or succeed(before, self._wall_ns(stamp_ns), self.host)
        self._unnoted.append((name, count, writer, version))
        cell.version, cell.count = version, count
        if version.host == self.host:
            self.news[name] = None
        return version

    def note(self) -> None:
        """Keep the versions that were given here for the next daemon.

        That may be done once the messages are on their way. A daemon that is killed before leaves
        them to be given again, from the same stamps.
        """
        for given in self._unnoted:
            self._journal.note(*given)
        self._unnoted.clear()

    def declare(self, declaration: Declaration) -> None:
        """Make a slot that is not on the board. Raise `Refused` if it cannot be."""
        try:
            kind = type_from_schema(declaration.schema)
            slot = Slot(declaration.slot, kind, declaration.capacity)
            cell = Cell(slot, self.board[slot])
        except Exception as error:  # whatever another host calls a schema
            raise Refused(f"slot {declaration.slot!r}: cannot be made: {error}") from error
        self._cells.setdefault(declaration.slot, cell)

    def declaration(self, cell: Cell) -> Declaration:
        """Describe a slot that is on the board."""
        return Declaration(cell.slot.name, cell.capacity, cell.slot.schema)

    def clash(self, cell: Cell, theirs: Declaration) -> str:
        """Tell how the sender's type of a slot differs from the board's."""
        ours = cell.slot
        try:
            how = "; ".join(differences(ours.schema, theirs.schema))
        except Exception:  # whatever another host calls a schema
            how = "theirs is no schema of a message"
        return (
            f"slot {theirs.slot!r} holds {ours.type_name} here, {theirs.schema.get('title')} at "
            f"the sender, which `ours` means in: {how}"
        )

    def enter(self, cell: Cell, value: Value) -> Outcome:
        """Add a message of another host, unless the board's is as new or newer.

        If a process adds at the same moment, its message is compared as well. Raise `Refused` if it
        is no message of the slot, or too long.
        """
        version, payload = value.version, value.payload
        if len(payload) > cell.capacity:
            raise Refused(
                f"slot {value.slot!r}: the message takes {len(payload)} bytes, "
                f"the slot holds {cell.capacity} here"
            )
        message: Message | None = None
        while True:
            ours = cell.version if cell.bound.count == cell.count else self.version(cell)
            if ours is not None and ours >= version:
                return Outcome.KNOWN if ours == version else Outcome.OLDER
            if message is None:
                message = self._decode(cell, payload)
            self.note()
            # Noted before it is added: a daemon that is killed in between leaves an entry of a
            # number and a writer that no message has.
            self._journal.note(value.slot, cell.count + 1, self._pid, version)
            count = cell.bound.add_after(message, cell.count)
            if count:
                cell.count, cell.version = count, version
                return Outcome.ENTERED

    def _decode(self, cell: Cell, payload: bytes) -> Message:
        try:
            message: Message = cell.decode(payload)
        except (msgspec.DecodeError, ValueError, TypeError, RecursionError) as error:
            what = f"slot {cell.slot.name!r}: what the sender has sent is no {cell.slot.type_name}"
            raise Refused(f"{what}: {error}") from error
        return message
