"""Messages as texts: JSON objects, names of types as users write them, tables for notebooks."""

from __future__ import annotations

import importlib
import json
from collections.abc import Iterable, Sequence
from functools import cache
from html import escape
from pkgutil import iter_modules

import msgspec

from llfsm.errors import did_you_mean
from llfsm.whiteboard import messages
from llfsm.whiteboard.errors import MessageFieldError, MessageTypeError, name_fields
from llfsm.whiteboard.message import Message
from llfsm.whiteboard.schema import from_plain, to_plain
from llfsm.whiteboard.slots import Slot


def message_json(message: Message) -> str:
    """Write a message as a JSON object, its bytes in base64; for :func:`parse_message`."""
    return msgspec.json.encode(to_plain(message)).decode(errors="replace")


def parse_message(slot: Slot[Message], text: str | bytes) -> Message:
    """Make a message of a slot's type from a JSON object.

    Omitted fields are zero, empty or false. Raise :class:`.MessageFieldError` if the text is not a
    JSON object with the type's fields.
    """
    try:
        value = json.loads(text)
    except (ValueError, RecursionError) as error:  # the latter if it is nested too deeply
        raise MessageFieldError(f"slot {slot.name!r}: {_no_object(slot)}: {error}") from error
    if not isinstance(value, dict):
        raise MessageFieldError(f"slot {slot.name!r}: {_no_object(slot)}")
    try:
        return msgspec.convert(from_plain(value, slot.schema), slot.type)
    except (ValueError, RecursionError) as error:  # includes msgspec's
        what = name_fields(slot.type, error)
        raise MessageFieldError(f"slot {slot.name!r}: invalid message: {what}") from error


def _no_object(slot: Slot[Message]) -> str:
    fields = slot.type.__struct_fields__
    example = f'{{"{fields[0]}": ...}}' if fields else "{}"
    return f"invalid message: not a JSON object such as {example}"


def message_class(name: str) -> type[Message]:
    """Import the class ``package.module:Class``, or a shipped type, as ``geometry_msgs/Twist``.

    Raise :class:`.MessageTypeError` if there is none, or it is not a Message class.
    """
    module, colon, attribute = name.partition(":")
    if not colon:
        return _shipped(name)
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


@cache
def shipped_types() -> tuple[type[Message], ...]:
    """Return the types of ROS's packages that ship, without the messages of llfsm's processes."""
    found = iter_modules(messages.__path__, f"{messages.__name__}.")
    return tuple(
        value
        for module in (importlib.import_module(each.name) for each in found)
        for value in vars(module).values()
        if isinstance(value, type)
        and issubclass(value, Message)
        and value.__module__ == module.__name__
        and "/" in value.__type_name__  # type: ignore[attr-defined]
    )


def _shipped(name: str) -> type[Message]:
    packages: dict[str, dict[str, type[Message]]] = {}
    for each in shipped_types():
        package = each.__module__.rpartition(".")[2]
        packages.setdefault(package, {})[each.__name__] = each
    package, _, attribute = name.partition("/")
    types = packages.get(package)
    if types is None:
        raise MessageTypeError(
            f"no message type {name!r}: give it as package.module:Class, or as "
            f"geometry_msgs/Twist if it ships with llfsm, whose packages are "
            f"{', '.join(packages)}{did_you_mean(package, packages)}"
        )
    attribute = attribute.removeprefix("msg/")
    if attribute not in types:
        near = did_you_mean(attribute, types)
        raise MessageTypeError(f"no message type {name!r}: {package} has no {attribute!r}{near}")
    return types[attribute]


def html_table(head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Make an HTML table for a notebook; every cell is shown as text, whatever it contains."""
    lines = ["<table>", _row("th", head), *(_row("td", row) for row in rows), "</table>"]
    return "\n".join(lines)


def _row(kind: str, cells: Iterable[object]) -> str:
    return f"<tr>{''.join(f'<{kind}>{escape(str(cell))}</{kind}>' for cell in cells)}</tr>"
