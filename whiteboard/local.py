"""A board in one process: for tests, simulation, and systems without shared memory.

It keeps each message encoded, and every handle decodes it for itself, as in shared memory: so the
checks and errors are the same, and slots of one name may have classes of their own. One lock is
held for an add and for a wait. The clock can be given, for simulated time.
"""

from __future__ import annotations

import os
import threading
import time
import weakref
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

from llfsm.whiteboard.board import Board, BoundSlot, SlotInfo, Waiter
from llfsm.whiteboard.errors import (
    BoardClosedError,
    SlotNotFoundError,
    SlotRetiredError,
    too_large,
    wrong_field,
)
from llfsm.whiteboard.message import M, as_type
from llfsm.whiteboard.slots import Sample, Slot


class _Added(NamedTuple):
    """A message as it was added: encoded, because slots of one name may differ in class."""

    data: bytes
    number: int
    stamp_ns: int
    writer: int


class _Cell:
    """A slot of the board, which all handles of its name share."""

    def __init__(self, slot: Slot[Any]) -> None:
        self.slot = slot
        self.latest: _Added | None = None
        self.on_add: list[weakref.WeakMethod[Callable[[int], None]]] = []
        self.awaited_by: list[threading.Condition] = []  # of waiters for several slots
        self.readers: weakref.WeakSet[_LocalSlot[Any]] = weakref.WeakSet()

    @property
    def count(self) -> int:
        return 0 if self.latest is None else self.latest.number


class _LocalSlot(BoundSlot[M]):
    added = 0

    def __init__(self, board: LocalBoard, slot: Slot[M], cell: _Cell) -> None:
        self._board = board
        self._slot = slot
        self.cell = cell
        self._read: tuple[_Added, Sample[M]] | None = None
        self._retired = False
        self._reads = False

    @property
    def count(self) -> int:
        self._board.check_open()
        return self.cell.count

    @property
    def capacity(self) -> int:
        return self.cell.slot.capacity

    def add(self, message: M, /) -> int:
        return self._add(message, None)

    def add_after(self, message: M, count: int, /) -> int:
        return self._add(message, count)

    def _add(self, message: M, after: int | None) -> int:
        self._board.check_open()
        slot = self._slot
        if type(message) is not slot.type:
            message = as_type(slot.name, slot.type, message)
        if self._retired:
            raise SlotRetiredError(f"slot {slot.name!r}: this handle was retired and adds no more")
        try:  # as in shared memory, so that a test finds the same errors as a robot
            data = slot.encoder.encode(message)
            message = slot.decoder.decode(data)
        except Exception as error:  # the encoder and a field's own code may raise anything
            raise wrong_field(slot.name, slot.type, error) from error
        if len(data) > self.capacity:
            raise too_large(slot.name, len(data), self.capacity)
        with self._board.changed:
            count = self.cell.count
            if after is not None and after != count:
                return 0
            added = _Added(data, count + 1, self._board.now_ns(), os.getpid())
            self._read = added, Sample(message, *added[1:])
            self.cell.latest = added
            for reference in self.cell.on_add[:]:
                callback = reference()
                if callback is None:
                    self.cell.on_add.remove(reference)
                else:
                    callback(added.number)
            self._board.changed.notify_all()
            for waiter in self.cell.awaited_by:
                waiter.notify_all()
        self.added = added.number
        return added.number

    def reserve(self) -> None:
        self._board.check_open()

    def retire(self) -> None:
        self._retired = True

    def on_add(self, callback: Callable[[int], None]) -> None:
        self.cell.on_add.append(weakref.WeakMethod(callback))

    def get(self) -> M | None:
        sample = self.sample()
        return None if sample is None else sample[0]

    def sample(self) -> Sample[M] | None:
        self._board.check_open()
        self.begin_reading()
        latest, read = self.cell.latest, self._read
        if latest is None:
            return None
        if read is None or read[0] is not latest:
            message = self._slot.decoder.decode(latest.data)
            read = self._read = latest, Sample(message, *latest[1:])
        return read[1]

    def encoded(self) -> tuple[bytes, int, int, int] | None:
        self._board.check_open()
        return self.cell.latest

    def begin_reading(self) -> None:
        if not self._reads:
            with self._board.changed:
                self._reads = True
                self.cell.readers.add(self)
                self._board.wake_watchers()

    def wait(self, *, after: int, timeout: float | None = None) -> Sample[M] | None:
        with self._board.changed:
            newer = self.wait_count(after=after, timeout=timeout)
            return self.sample() if newer else None

    def wait_count(self, *, after: int, timeout: float | None = None) -> int | None:
        if timeout is not None:
            timeout = min(timeout, threading.TIMEOUT_MAX)
        self.begin_reading()
        with self._board.changed:
            newer = self._board.changed.wait_for(lambda: self.count > after, timeout)
            return self.count if newer else None


class LocalBoard(Board):
    """A whiteboard for the threads of one process; a new one is empty.

    The name is for error texts only. `now_ns` is the clock of the messages' stamps, by default
    CLOCK_MONOTONIC.
    """

    readings = 0

    def __init__(self, name: str = "local", now_ns: Callable[[], int] = time.monotonic_ns) -> None:
        super().__init__(name)
        self.now_ns = now_ns
        self.lock = threading.RLock()  # a signal's handler may wake the thread that it interrupts
        self.changed = threading.Condition(self.lock)
        self._cells: dict[str, _Cell] = {}
        self._open = True

    def check_open(self) -> None:
        """Raise :class:`.BoardClosedError` if the board was closed."""
        if not self._open:
            raise BoardClosedError(f"{self.name}: this whiteboard was closed")

    def publisher(self, slot: Slot[M], *, make: bool = True) -> _LocalSlot[M]:
        """Bind a slot to a new handle; see :meth:`.Board.publisher`."""
        self.check_open()
        if not make:
            self.find(slot.name)
        cell = self._cells.setdefault(slot.name, _Cell(slot))
        if cell.slot.fingerprint != slot.fingerprint:
            raise slot.clash(cell.slot.schema)
        return _LocalSlot(self, slot, cell)

    def slots(self) -> list[SlotInfo]:
        """Return the slots on the board."""
        self.check_open()
        slots = [cell.slot for cell in self._cells.values()]
        return [SlotInfo(slot.name, slot.type_name, slot.schema, slot.capacity) for slot in slots]

    def find(self, name: str) -> Slot[Any]:
        """Return the slot of that name, with the class of its first use."""
        self.check_open()
        if name not in self._cells:
            raise SlotNotFoundError(self.name, name, self._cells)
        return self._cells[name].slot

    def watcher(self) -> Callable[[float], list[str]]:
        """Make a function that waits for a new message in any slot; see :meth:`.Board.watcher`."""
        counts: dict[str, int] = {}
        seen = self.readings

        def changed() -> list[str]:
            self.check_open()
            cells = list(self._cells.items())
            return [name for name, cell in cells if cell.count != counts.get(name, 0)]

        def wait(timeout: float) -> list[str]:
            nonlocal seen
            with self.changed:
                self.changed.wait_for(lambda: changed() or self.readings != seen, timeout)
                seen, found = self.readings, changed()
                counts.update((name, self._cells[name].count) for name in found)
                return found

        return wait

    def read_slots(self) -> set[str]:
        """Return the names of the slots that are read; see :meth:`.Board.read_slots`."""
        self.check_open()
        return {name for name, cell in list(self._cells.items()) if len(cell.readers)}

    def waiter(self) -> Waiter:
        """Make a waiter for new messages in any of several slots; see :meth:`.Board.waiter`."""
        return _LocalWaiter(self)

    def wake_watchers(self) -> None:
        """End the wait of each watcher, also without a new message."""
        with self.changed:
            self.readings += 1
            self.changed.notify_all()

    @property
    def alive(self) -> bool:
        """False once closed."""
        return self._open

    def close(self) -> None:
        """Close the board and discard its messages."""
        self._open = False
        with self.changed:  # waiting threads look at it
            self.changed.notify_all()
            for cell in self._cells.values():
                for waiter in cell.awaited_by:
                    waiter.notify_all()

    def remove(self) -> None:
        """Close the board."""
        self.close()


class _LocalWaiter:
    def __init__(self, board: LocalBoard) -> None:
        self._board = board
        self._woken = False
        self._changed = threading.Condition(board.lock)

    def wait(self, seen: dict[BoundSlot[Any], int], timeout: float) -> list[BoundSlot[Any]]:
        slots = [slot for slot in seen if isinstance(slot, _LocalSlot)]
        for each in slots:
            each.begin_reading()
        cells = [slot.cell for slot in slots]

        def newer() -> list[BoundSlot[Any]]:
            self._board.check_open()
            return [slot for slot, count in seen.items() if slot.count > count]

        with self._changed:
            for cell in cells:
                cell.awaited_by.append(self._changed)
            try:
                self._changed.wait_for(lambda: self._woken or newer(), timeout)
            finally:
                for cell in cells:
                    cell.awaited_by.remove(self._changed)
            self._woken = False
            found = newer()
            seen.update((slot, slot.count) for slot in found)
            return found

    def doze(self, *what: Any) -> Callable[[], bool]:
        return partial(what[-1], 0)

    def wake(self) -> None:
        with self._changed:
            self._woken = True
            self._changed.notify_all()
