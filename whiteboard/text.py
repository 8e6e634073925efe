"""Messages and their types as a person writes them: a JSON object, ``geometry_msgs/Twist``."""

from __future__ import annotations

import importlib
import json

import msgspec

from .errors import MessageFieldError, SlotNotFoundError, name_fields
from .message import Message
from .schema import from_plain
from .slots import Slot

__all__ = ["message_class", "parse_message"]


def parse_message(slot: Slot[Message], text: str | bytes) -> Message:
    """Return the message of a slot's type that a JSON object tells; fields left out are zero.

    Raise `MessageFieldError`.
    """
    try:
        plain = from_plain(json.loads(text), slot.schema)
        return msgspec.convert(plain, slot.type)
    except ValueError as error:  # also msgspec's, which is one
        what = name_fields(slot.type, error)
        raise MessageFieldError(f"no message for {slot.name!r}: {what}") from error


def message_class(name: str) -> type[Message]:
    """Return the class of ``package.module:Class``, or of a shipped type, ``geometry_msgs/Twist``.

    Raise `SlotNotFoundError`.
    """
    module, colon, attribute = name.partition(":")
    if not colon:
        package, _, attribute = name.partition("/")
        attribute = attribute.removeprefix("msg/")
        module = f"llfsm.whiteboard.messages.{package}"
    try:
        found = getattr(importlib.import_module(module), attribute)
    except (ImportError, AttributeError, ValueError) as error:
        raise SlotNotFoundError(f"no message type {name!r}: {error}") from error
    if not (isinstance(found, type) and issubclass(found, Message)):
        raise SlotNotFoundError(f"{name!r} is no Message class")
    return found
