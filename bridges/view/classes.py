"""The message class for a slot of a board or recording, whose own class is not at hand."""

from __future__ import annotations

from functools import lru_cache

import msgspec

from llfsm.whiteboard import Message, MessageTypeError
from llfsm.whiteboard.board import SlotInfo
from llfsm.whiteboard.messages.llfsm import (
    DEFINITIONS,
    MACHINES,
    MachineDefinition,
    MachineStatus,
)
from llfsm.whiteboard.schema import describe, type_from_schema

__all__ = ["class_of"]

_OURS: dict[str, type[Message]] = {MACHINES: MachineStatus, DEFINITIONS: MachineDefinition}
_SCHEMAS = {prefix: describe(cls) for prefix, cls in _OURS.items()}


def class_of(info: SlotInfo) -> type[Message]:
    """Return the class of a slot's messages: our own for what machines tell, else a made one.

    Raise :class:`.MessageTypeError` if the schema is none.
    """
    if info.problem:
        raise MessageTypeError(info.problem)
    for prefix, cls in _OURS.items():
        if info.name.startswith(prefix) and info.schema == _SCHEMAS[prefix]:
            return cls
    return _made(msgspec.json.encode(info.schema))


@lru_cache(maxsize=1024)  # slots of the same type share a class: to make one takes long
def _made(schema: bytes) -> type[Message]:
    made: type[Message] = type_from_schema(msgspec.json.decode(schema))
    return made
