"""A board in this process only: for tests, simulation, and where there is no shared memory."""

from __future__ import annotations

import os
import threading
import time
from typing import Any

from .board import Board, BoundSlot, Sample, SlotInfo
from .errors import BoardClosedError, too_large, wrong_field, wrong_type
from .message import M
from .slots import Slot

__all__ = ["LocalBoard"]


class _LocalSlot(BoundSlot[M]):
    def __init__(self, board: LocalBoard, slot: Slot[M]) -> None:
        self._board = board
        self._slot = slot
        self._latest: Sample[M] | None = None
        self._changed = threading.Condition()

    @property
    def count(self) -> int:
        latest = self.sample()
        return 0 if latest is None else latest.count

    @property
    def capacity(self) -> int:
        return self._slot.capacity

    def add(self, message: M, /) -> int:
        self._board.check_open()
        slot = self._slot
        if type(message) is not slot.type:
            raise wrong_type(slot.name, slot.type, message)
        try:  # as on its way through shared memory, so that a test finds what a robot would
            data = slot.encoder.encode(message)
            message = slot.decoder.decode(data)
        except Exception as error:  # whatever the encoder or a field's own code raises
            raise wrong_field(slot.name, slot.type, error) from error
        if len(data) > slot.capacity:
            raise too_large(slot.name, len(data), slot.capacity)
        with self._changed:
            count = self.count + 1
            self._latest = Sample(message, count, time.monotonic_ns(), os.getpid())
            self._changed.notify_all()
        return count

    def get(self) -> M | None:
        latest = self.sample()
        return None if latest is None else latest[0]

    def sample(self) -> Sample[M] | None:
        self._board.check_open()
        return self._latest

    def wait(self, *, after: int, timeout: float | None = None) -> Sample[M] | None:
        if timeout is not None:
            timeout = min(timeout, threading.TIMEOUT_MAX)
        with self._changed:
            newer = self._changed.wait_for(lambda: self.count > after, timeout)
            return self.sample() if newer else None

    def wake(self) -> None:
        """Let those who wait see that the board was closed."""
        with self._changed:
            self._changed.notify_all()


class LocalBoard(Board):
    """A whiteboard for the threads of one process; every new one is empty."""

    def __init__(self, name: str = "local") -> None:
        super().__init__(name)
        self._slots: dict[str, tuple[Slot[Any], _LocalSlot[Any]]] = {}
        self._open = True

    def check_open(self) -> None:
        """Raise :class:`.BoardClosedError` if the board was closed."""
        if not self._open:
            raise BoardClosedError(f"{self.name}: this whiteboard was closed")

    def _bind(self, slot: Slot[M]) -> BoundSlot[M]:
        self.check_open()
        made, bound = self._slots.setdefault(slot.name, (slot, _LocalSlot(self, slot)))
        if made.fingerprint != slot.fingerprint:
            raise slot.clash(made.schema)
        return bound

    def slots(self) -> list[SlotInfo]:
        """Describe the slots."""
        self.check_open()
        return [
            SlotInfo(slot.name, slot.type_name, slot.schema, slot.capacity)
            for slot, _ in self._slots.values()
        ]

    @property
    def alive(self) -> bool:
        """False once closed."""
        return self._open

    def close(self) -> None:
        """Close the board, and with it forget every message."""
        self._open = False
        for _, bound in list(self._slots.values()):
            bound.wake()

    remove = close
