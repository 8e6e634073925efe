"""What to relay: from a TOML file, whose keys are the fields here, or from the command line."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import msgspec

from llfsm.runtime.engine.errors import ConfigurationError
from llfsm.runtime.plans.toml_files import read_toml
from llfsm.whiteboard import Message, Slot, SlotNameError, SlotNotFoundError
from llfsm.whiteboard.text import message_class

from .errors import LayoutError
from .file import DEFAULT_PATH, TYPES
from .layouts import MessageLayout, find_layout
from .relay import Direction

__all__ = ["ConfiguredRelay", "RelayConfiguration", "check_configuration", "read_configuration"]

_BLAMED = {LayoutError: "layout", SlotNotFoundError: "type", SlotNameError: "slot"}


class ConfiguredRelay(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A number of the gusimplewhiteboard and a slot, with the slot's type.

    `layout` is a struct format or ``module:Structure``, `fields` are the message's in the order of
    a format. `direction` is ``in`` from the gusimplewhiteboard, ``out`` to it, or ``both``.
    """

    number: Annotated[int, msgspec.Meta(ge=0, lt=TYPES)]
    slot: str
    type: str
    layout: str
    fields: tuple[str, ...] | None = None
    direction: Direction = "both"

    def resolve(self) -> tuple[Slot[Message], MessageLayout]:
        """Return its slot and layout, with modules from the current folder, too.

        Raise :class:`.SlotNameError`, :class:`.SlotNotFoundError` (of the type) or
        :class:`.LayoutError`.
        """
        if str(Path.cwd()) not in sys.path:
            sys.path.insert(0, str(Path.cwd()))
        slot = Slot(self.slot, message_class(self.type))
        return slot, find_layout(self.layout, slot.schema, self.fields)


class RelayConfiguration(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The file of a gusimplewhiteboard, a whiteboard, and what is relayed between them."""

    relays: tuple[ConfiguredRelay, ...] = msgspec.field(name="relay", default=())
    file: str = DEFAULT_PATH
    board: str | None = None
    period_ms: Annotated[float, msgspec.Meta(gt=0)] = 5.0


def read_configuration(file: Path) -> RelayConfiguration:
    """Read a TOML file; raise :class:`.ConfigurationError` with the line of what is wrong."""
    return read_toml(file, RelayConfiguration, check_configuration)


def check_configuration(plan: RelayConfiguration) -> None:
    """Raise :class:`.ConfigurationError` for what the types cannot say."""
    for key in ("number", "slot"):
        seen = set()
        for index, relay in enumerate(plan.relays):
            value = getattr(relay, key)
            if value in seen:
                raise ConfigurationError(f"{value} is relayed twice", ("relay", index, key))
            seen.add(value)
    for index, relay in enumerate(plan.relays):
        try:
            relay.resolve()
        except (LayoutError, SlotNotFoundError, SlotNameError) as error:
            key = _BLAMED[type(error)]
            raise ConfigurationError(str(error), ("relay", index, key)) from error
