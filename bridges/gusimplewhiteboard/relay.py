"""Relay messages between a type of a gusimplewhiteboard and a slot, in one direction or both."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable
from typing import Literal

import msgspec

from llfsm.whiteboard import Board, Message, MessageError, MessageUnreadableError, Slot
from llfsm.whiteboard.errors import name_fields
from llfsm.whiteboard.schema import from_plain

from .errors import GuFileError, MisfitError
from .file import GuWhiteboard, RingPosition
from .message_layouts import MessageLayout

__all__ = ["Direction", "Relay", "run"]

Direction = Literal["in", "out", "both"]

_log = logging.getLogger(__name__)
_PERIODS_A_CHECK = 100  # whether the file still exists


class Relay:
    """Relay new messages between one type and one slot.

    A message that came from the other side is not sent back. If both sides have changed since the
    last step, the gusimplewhiteboard's message wins; when the relay is created, the slot's does.
    """

    def __init__(
        self,
        foreign: GuWhiteboard,
        number: int,
        board: Board,
        slot: Slot[Message],
        layout: MessageLayout,
        direction: Direction = "both",
    ) -> None:
        self._foreign = foreign
        self._number = number
        self._slot = slot
        self._bound = board[slot]
        self._layout = layout
        self._arrow = {"in": "->", "out": "<-", "both": "<->"}[direction]
        self._inwards = direction in ("in", "both")
        self._outwards = direction in ("out", "both")
        self._count = 0  # of the slot's latest message that was relayed
        self._position = RingPosition(0, 0)  # of the type's latest message that was relayed
        self._uncounted = self._position
        if direction == "both" and self._bound.count:
            self._position = foreign.position(number)
        self._refusing = False
        self.relayed_in = self.relayed_out = self.refused = 0

    def __str__(self) -> str:
        return f"{self._number} {self._arrow} {self._slot.name}"

    def step(self) -> None:
        """Relay new messages; never block."""
        try:
            if self._inwards:
                self._step_in()
            if self._outwards:
                self._step_out()
        except (MisfitError, MessageError) as error:
            self.refused += 1
            if not self._refusing:  # once, not for each message
                _log.warning("%s: a message was not relayed: %s", self, error)
            self._refusing = True

    def _step_in(self) -> None:
        position = self._foreign.position(self._number)
        if position == self._position:
            return
        if position.counter == self._position.counter and position != self._uncounted:
            self._uncounted = (
                position  # its writer is about to count it; else the next step reads it
            )
            return
        found = self._foreign.read(self._number, self._layout.size)
        if found is None:
            return
        data, self._position = found
        self._count = self._bound.add(self._message(data))
        self.relayed_in += 1
        self._refusing = False

    def _message(self, data: bytes) -> Message:
        try:
            return msgspec.convert(
                from_plain(self._layout.decode(data), self._slot.schema), self._slot.type
            )
        except ValueError as error:
            raise MisfitError(name_fields(self._slot.type, error)) from error

    def _step_out(self) -> None:
        if self._bound.count == self._count:
            return
        try:
            sample = self._bound.sample()
        except MessageUnreadableError as error:
            self._count = error.count
            raise
        if sample is not None:
            self._count = sample.count
            self._position = self._foreign.add(self._number, self._layout.encode(sample.message))
            self.relayed_out += 1
            self._refusing = False


def run(
    foreign: GuWhiteboard,
    relays: Iterable[Relay],
    wait: Callable[[], bool],
    alive: Callable[[], bool],
) -> None:
    """Step all relays repeatedly, until `wait` returns True or the board is not `alive`.

    Raise :class:`.GuFileError` if the file was removed or replaced.
    """
    relays = list(relays)
    periods = 0
    while alive() and not wait():
        if periods % _PERIODS_A_CHECK == 0 and not foreign.is_there:
            raise GuFileError(f"{foreign.path}: the file was removed or replaced; start again")
        for relay in relays:
            relay.step()
        periods += 1
