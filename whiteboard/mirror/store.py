"""A board with the version of each slot's message: what the merge rule is applied to."""

from __future__ import annotations

import os
from collections.abc import Callable
from enum import Enum, auto
from typing import Any

import msgspec

from ..board import Board, BoundSlot, Sample, SlotInfo
from ..errors import MessageTypeError, MessageUnreadableError, SlotError
from ..message import Message
from ..schema import differences, type_from_schema
from ..slots import Slot
from .journal import Journal
from .merge import Version, succeed
from .wire import Declaration, Value

__all__ = ["Outcome", "Refused", "Store"]


class Outcome(Enum):
    """What becomes of a message of another host."""

    ENTERED = auto()
    KNOWN = auto()
    OLDER = auto()


class Refused(Exception):  # noqa: N818  not for users: it is counted and reported
    """Tell why a message does not enter: what is reported, once."""


class _Cell:
    """A slot, with the version of the message of number `count`."""

    def __init__(self, slot: Slot[Any], bound: BoundSlot[Any]) -> None:
        self.slot = slot
        self.bound = bound
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
        self._wall_ns = wall_ns
        self._journal = journal
        self._cells: dict[str, _Cell] = {}
        self._news: dict[str, None] = {}  # in the order in which they were found

    def has_news(self, name: str) -> bool:
        """Tell whether somebody here has added to a slot since it was last looked at."""
        try:
            cell = self._cell(name)
        except Refused:
            return False
        return cell.bound.count != cell.count

    def names(self) -> list[str]:
        """Return the slots on the board that can be read."""
        return [info.name for info in self.board.slots() if self._is_readable(info)]

    def _is_readable(self, info: SlotInfo) -> bool:
        try:
            self._cell(info.name)
        except Refused:
            return False
        return True

    def take_news(self) -> list[str]:
        """Return the slots in which a message of this host was found since the last call."""
        news, self._news = list(self._news), {}
        return news

    def latest(self, name: str) -> Value | None:
        """Return the latest message of a slot that is on the board, or None before the first.

        Raise `Refused` for one that is none of its type.
        """
        cell = self._cell(name)
        sample = self._settle(cell)
        if sample is None or cell.version is None:
            return None
        payload = cell.slot.encoder.encode(sample.message)
        return Value(name, cell.slot.fingerprint, *cell.version, payload)

    def version(self, name: str) -> Version | None:
        """Return the version of a slot's latest message; as :meth:`latest`."""
        cell = self._cell(name)
        self._settle(cell)
        return cell.version

    def _cell(self, name: str) -> _Cell:
        cell = self._cells.get(name)
        if cell is None:
            try:
                slot = self.board.find(name)
                cell = self._cells[name] = _Cell(slot, self.board[slot])
            except (SlotError, MessageTypeError) as error:  # what some process wrote of it
                raise Refused(str(error)) from error
        return cell

    def _settle(self, cell: _Cell) -> Sample[Message] | None:
        """Give a message that somebody here has added its version."""
        try:
            sample: Sample[Message] | None = cell.bound.sample()
        except MessageUnreadableError as error:
            raise Refused(str(error)) from error
        if sample is not None and sample.count != cell.count:
            _, count, stamp_ns, writer = sample
            known, before = None, cell.version
            if before is None:
                known, before = self._journal.recall(cell.slot.name, count, writer)
            cell.version = known or succeed(before, self._wall_ns(stamp_ns), self.host)
            cell.count = count
            self._journal.note(cell.slot.name, count, writer, cell.version)
            if cell.version.host == self.host:
                self._news[cell.slot.name] = None
        return sample

    def declare(self, declaration: Declaration) -> None:
        """Make a slot that is not on the board. Raise `Refused` if it cannot be."""
        try:
            kind = type_from_schema(declaration.schema)
            slot = Slot(declaration.slot, kind, declaration.capacity)
            cell = _Cell(slot, self.board[slot])
        except Exception as error:  # whatever another host calls a schema
            raise Refused(f"slot {declaration.slot!r}: cannot be made: {error}") from error
        self._cells.setdefault(declaration.slot, cell)

    def declaration(self, name: str) -> Declaration:
        """Describe a slot that is on the board."""
        cell = self._cell(name)
        return Declaration(name, cell.bound.capacity, cell.slot.schema)

    def knows(self, name: str) -> bool:
        """Tell whether the slot was used here."""
        return name in self._cells

    def has(self, name: str) -> bool:
        """Tell whether the board has the slot, used here or not."""
        if name not in self._cells:
            self.names()
        return name in self._cells

    def agrees(self, value: Value) -> bool:
        """Tell whether the sender's type of a slot is the board's."""
        return value.kind == self._cell(value.slot).slot.fingerprint

    def clash(self, theirs: Declaration) -> str:
        """Tell how the sender's type of a slot differs from the board's."""
        ours = self._cell(theirs.slot).slot
        try:
            how = "; ".join(differences(ours.schema, theirs.schema))
        except Exception:  # whatever another host calls a schema
            how = "theirs is no schema of a message"
        return (
            f"slot {theirs.slot!r} holds {ours.type_name} here, {theirs.schema.get('title')} at "
            f"the sender, which `ours` means in: {how}"
        )

    def enter(self, value: Value) -> Outcome:
        """Add a message of another host, unless the board's is as new or newer.

        If a process adds at the same moment, its message is compared as well. Raise `Refused` if it
        is no message of the slot, or too long.
        """
        cell = self._cell(value.slot)
        room = cell.bound.capacity
        if len(value.payload) > room:
            raise Refused(
                f"slot {value.slot!r}: the message takes {len(value.payload)} bytes, "
                f"the slot holds {room} here"
            )
        if (outcome := self._compare(cell, value.version)) is not Outcome.ENTERED:
            return outcome
        try:
            message = cell.slot.decoder.decode(value.payload)
        except (msgspec.DecodeError, ValueError, TypeError, RecursionError) as error:
            what = f"slot {value.slot!r}: what the sender has sent is no {cell.slot.type_name}"
            raise Refused(f"{what}: {error}") from error
        while (outcome := self._compare(cell, value.version)) is Outcome.ENTERED:
            # Noted before it is added: a daemon that is killed in between leaves an entry of a
            # number and a writer that no message has.
            self._journal.note(value.slot, cell.count + 1, os.getpid(), value.version)
            count = cell.bound.add_after(message, cell.count)
            if count:
                cell.count, cell.version = count, value.version
                break
        return outcome

    def _compare(self, cell: _Cell, version: Version) -> Outcome:
        if cell.bound.count != cell.count:
            self._settle(cell)
        if cell.version is None or cell.version < version:
            return Outcome.ENTERED
        return Outcome.KNOWN if cell.version == version else Outcome.OLDER
