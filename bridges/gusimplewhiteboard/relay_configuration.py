"""The configuration of relays, as in a TOML file, whose keys are the fields here."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import msgspec

from llfsm.runtime.engine.errors import ConfigurationError
from llfsm.runtime.plans.toml_files import read_toml
from llfsm.whiteboard import Message, MessageTypeError, Slot, SlotNameError
from llfsm.whiteboard.message_text import message_class

from .errors import LayoutError
from .file import DEFAULT_PATH, TYPES
from .message_layouts import MessageLayout, find_layout
from .relay import Direction

__all__ = ["ConfiguredRelay", "RelayConfiguration", "check_configuration", "read_configuration"]

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
        """Return the slot and the layout; modules may be in the current folder.

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
    """Raise :class:`.ConfigurationError` for errors that the types do not exclude."""
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
