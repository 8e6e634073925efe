"""Polls all slots of a board together, for programs that show or record whatever is on it.

Such programs do not have the slots' own classes. A slot that cannot be used or read is reported
with its problem, and does not affect the others.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from llfsm.whiteboard.board import Board, BoundSlot, SlotInfo
from llfsm.whiteboard.errors import (
    BoardClosedError,
    MessageTypeError,
    SlotNotFoundError,
    WhiteboardError,
)
from llfsm.whiteboard.message import Message, type_from_schema
from llfsm.whiteboard.messages.llfsm import (
    COMMANDERS,
    DEFINITIONS,
    JOURNALS,
    MACHINES,
    REQUESTS,
    Commanders,
    MachineDefinition,
    MachineRequest,
    MachineStatus,
)
from llfsm.whiteboard.schema import describe
from llfsm.whiteboard.slot_names import KEEPS_READ
from llfsm.whiteboard.slots import Sample, Slot

_OURS: dict[str, type[Message]] = {
    MACHINES: MachineStatus,
    DEFINITIONS: MachineDefinition,
    COMMANDERS: Commanders,
    REQUESTS: MachineRequest,
}
_SCHEMAS = {prefix: describe(cls) for prefix, cls in _OURS.items()}


class PolledSlot:
    """A slot as of the latest poll."""

    __slots__ = ("count", "info", "problem", "sample", "slot")

    def __init__(self, info: SlotInfo) -> None:
        self.info = info
        self.slot: Slot[Any] | None = None
        """The slot, of the class that :func:`class_of` returns; None if it cannot be used."""
        self.count = 0
        """The number of messages added to it."""
        self.sample: Sample[Message] | None = None
        """Its latest message; None before the first, and if it cannot be read."""
        self.problem = ""
        """Why the slot cannot be used, or its latest message cannot be read."""

    @property
    def name(self) -> str:
        """The slot's name."""
        return self.info.name


@dataclass(eq=False)
class BoardPoller:
    """Reads the slots of a board whose names `wants` accepts, at each call of :meth:`poll`.

    It looks for new slots at the first poll and every `discovery_s` seconds; by default, at each.
    """

    board: Board
    wants: Callable[[str], bool] | None = None
    discovery_s: float = 0.0

    def __post_init__(self) -> None:
        self._wants = is_data if self.wants is None else self.wants
        self.slots: dict[str, PolledSlot] = {}
        """The slots found so far, by name, in the order in which they were made."""
        self._due_s = 0.0  # when to discover next
        self._bound: list[tuple[PolledSlot, BoundSlot[Any]]] = []
        self._unusable: list[PolledSlot] = []  # found since the last poll

    def poll(self) -> list[PolledSlot]:
        """Read the slots; return those with a new message or a new problem since the last poll.

        Raise :class:`.BoardClosedError` if this process has closed the board.
        """
        now_s = time.monotonic()
        if now_s >= self._due_s:
            self._due_s = now_s + self.discovery_s
            self.discover()
        changed, self._unusable = self._unusable, []
        for polled, bound in self._bound:
            if bound.count != polled.count:
                _read(polled, bound)
                changed.append(polled)
        return changed

    def discover(self) -> None:
        """Find new slots now, and drop those that are gone. Raise as :meth:`poll` does."""
        listed = self.board.slots()
        gone = self.slots.keys() - {info.name for info in listed}
        for name in gone:
            slot = self.slots.pop(name).slot
            if slot is not None:
                self.board.forget(slot)
        if gone:
            self._bound = [each for each in self._bound if each[0].name not in gone]
        for info in listed:
            if info.name in self.slots or not self._wants(info.name):
                continue
            polled = self.slots[info.name] = PolledSlot(info)
            try:
                slot = Slot(info.name, class_of(info), info.capacity)
                self._bound.append((polled, self.board.present(slot)))
                polled.slot = slot
            except BoardClosedError:
                raise
            except SlotNotFoundError:  # it was given up since it was listed
                del self.slots[info.name]
            except WhiteboardError as error:
                polled.problem = str(error)
                self._unusable.append(polled)


def _read(polled: PolledSlot, bound: BoundSlot[Any]) -> None:
    polled.count = bound.count
    try:
        polled.sample = bound.sample()
    except BoardClosedError:
        raise
    except WhiteboardError as error:
        polled.sample, polled.problem = None, str(error)
    else:
        polled.problem = ""
        if polled.sample is not None:  # it may be newer than the count
            polled.count = polled.sample.count


def is_data(name: str) -> bool:
    """Check that a slot has messages to show: it carries no journal, and keeps no folder read."""
    return not name.startswith(JOURNALS) and not name.endswith(KEEPS_READ)


def class_of(info: SlotInfo) -> type[Message]:
    """Find the class of a slot's messages: llfsm's own, or one made from its schema.

    Raise :class:`.MessageTypeError` if the slot's schema is invalid.
    """
    if info.problem:
        raise MessageTypeError(info.problem)
    for prefix, cls in _OURS.items():
        if info.name.startswith(prefix) and info.schema == _SCHEMAS[prefix]:
            return cls
    return type_from_schema(info.schema)
