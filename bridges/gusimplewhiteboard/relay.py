"""Relay messages between types of a gusimplewhiteboard and slots, in one direction or both.

A relay polls both sides, and notes the position and the count up to which it has relayed. What it
writes itself moves these notes along, so that a message is never sent back. The fields of the
configuration are the keys of a TOML file.
"""

from __future__ import annotations

import logging
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Annotated, Literal

import msgspec

from llfsm.bridges.gusimplewhiteboard._structures import MessageLayout, find_layout
from llfsm.bridges.gusimplewhiteboard.errors import GuFileError, LayoutError, MisfitError
from llfsm.bridges.gusimplewhiteboard.file import DEFAULT_PATH, TYPES, GuWhiteboard, RingPosition
from llfsm.runtime.engine.errors import ConfigurationError
from llfsm.runtime.plans import read_toml
from llfsm.whiteboard import (
    Board,
    Message,
    MessageError,
    MessageTypeError,
    MessageUnreadableError,
    Slot,
    SlotNameError,
)
from llfsm.whiteboard.errors import name_fields
from llfsm.whiteboard.message_text import message_class
from llfsm.whiteboard.schema import from_plain

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
            # Its writer is about to count it; else the next step reads it.
            self._uncounted = position
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


_BLAMED = {LayoutError: "layout", MessageTypeError: "type", SlotNameError: "slot"}


class ConfiguredRelay(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A type's number in the gusimplewhiteboard and a slot, with the slot's message type.

    `layout` is a struct format or ``module:Structure``, `fields` are the message's fields in the
    order of the format. `direction` is ``in`` (from the gusimplewhiteboard), ``out`` or ``both``.
    """

    number: Annotated[int, msgspec.Meta(ge=0, lt=TYPES)]
    slot: str
    type: str
    layout: str
    fields: tuple[str, ...] | None = None
    direction: Direction = "both"

    def resolve(self) -> tuple[Slot[Message], MessageLayout]:
        """Find the slot and the layout; modules may be in the current folder.

        Raise :class:`.SlotNameError`, :class:`.MessageTypeError` or :class:`.LayoutError`.
        """
        if str(Path.cwd()) not in sys.path:
            sys.path.insert(0, str(Path.cwd()))
        slot = Slot(self.slot, message_class(self.type))
        return slot, find_layout(self.layout, slot.schema, self.fields)


class RelayConfiguration(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The file of a gusimplewhiteboard, a whiteboard, and the relays between them."""

    relays: tuple[ConfiguredRelay, ...] = msgspec.field(name="relay", default=())
    file: str = DEFAULT_PATH
    board: str | None = None
    period_ms: Annotated[float, msgspec.Meta(gt=0)] = 5.0


def read_configuration(file: Path) -> RelayConfiguration:
    """Read a TOML file; raise :class:`.ConfigurationError` with the line of the error."""
    return read_toml(file, RelayConfiguration, check_configuration)


def check_configuration(configuration: RelayConfiguration) -> None:
    """Raise :class:`.ConfigurationError` for errors that the fields' types do not exclude."""
    for key in ("number", "slot"):
        seen = set()
        for index, relay in enumerate(configuration.relays):
            value = getattr(relay, key)
            if value in seen:
                raise ConfigurationError(f"{value} is relayed twice", ("relay", index, key))
            seen.add(value)
    for index, relay in enumerate(configuration.relays):
        try:
            relay.resolve()
        except (LayoutError, MessageTypeError, SlotNameError) as error:
            key = _BLAMED[type(error)]
            raise ConfigurationError(str(error), ("relay", index, key)) from error
