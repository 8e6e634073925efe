"""Messages and message types as users write them: a JSON object, ``geometry_msgs/Twist``."""

from __future__ import annotations

import importlib
import json

import msgspec

from llfsm.errors import did_you_mean

from .errors import MessageFieldError, MessageTypeError, name_fields
from .message import Message
from .schema import from_plain
from .slots import Slot

__all__ = ["message_class", "parse_message"]


def parse_message(slot: Slot[Message], text: str | bytes) -> Message:
    """Return the message, of a slot's type, that a JSON object describes.

    Omitted fields are zero, empty or false. Raise :class:`.MessageFieldError` if it is not a JSON
    object with the type's fields.
    """
    try:
        plain = from_plain(json.loads(text), slot.schema)
        return msgspec.convert(plain, slot.type)
    except (ValueError, RecursionError) as error:  # includes msgspec's; and of nested JSON
        what = name_fields(slot.type, error)
        raise MessageFieldError(f"slot {slot.name!r}: invalid message: {what}") from error


def message_class(name: str) -> type[Message]:
    """Return the class ``package.module:Class``, or a shipped type as ``geometry_msgs/Twist``.

    Raise :class:`.MessageTypeError`.
    """
    module, colon, attribute = name.partition(":")
    if not colon:
        package, _, attribute = name.partition("/")
        attribute = attribute.removeprefix("msg/")
        module = f"llfsm.whiteboard.messages.{package}"
    try:
        within = importlib.import_module(module)
    except (ImportError, ValueError, TypeError) as error:  # as of ".a:B"
        raise MessageTypeError(f"no message type {name!r}: {error}") from error
    found = getattr(within, attribute, None)
    if found is None:
        types = [each for each, value in vars(within).items() if isinstance(value, type)]
        near = did_you_mean(attribute, types)
        raise MessageTypeError(f"no message type {name!r}: {module} has no {attribute!r}{near}")
    if not (isinstance(found, type) and issubclass(found, Message)):
        raise MessageTypeError(f"{name!r} is not a Message class")
    return found
