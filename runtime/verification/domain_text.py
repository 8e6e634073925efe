"""Domains as an arrangement file or a command line gives them."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import product
from typing import TYPE_CHECKING, Any

import msgspec

from llfsm.errors import did_you_mean

from .domains import every
from .errors import DomainError

if TYPE_CHECKING:
    from llfsm.whiteboard import Slot

__all__ = ["domain_of"]

_EVERY, _NONE = "every", "none"


def domain_of(slot: Slot[Any], given: Any) -> tuple[Any, ...]:
    """Return the messages of a domain for `slot`: "every", a list of messages, or a table.

    A message is a table of its fields, and "none" is no message. A table maps fields to "every" or
    to lists of values: the domain has all combinations. Fields that are left out are zero, empty or
    false. Raise `DomainError`.
    """
    if given == _EVERY:
        return every(slot.type)
    if isinstance(given, Mapping):
        names = list(given)
        values = [_values(slot, name, each) for name, each in given.items()]
        given = [dict(zip(names, row, strict=True)) for row in product(*values)]
    if not isinstance(given, list):
        raise DomainError(
            f"the domain of {slot.name!r} is {given!r}: it must be {_EVERY!r}, a list of messages, "
            f'or a table of fields, as in {{"level": [0, 9]}}'
        )
    return tuple(_message(slot, each) for each in given)


def _values(slot: Slot[Any], name: str, given: Any) -> list[Any]:
    """Return the values of a field, as data."""
    fields = {field.encode_name: field for field in msgspec.structs.fields(slot.type)}
    if name not in fields:
        raise DomainError(
            f"the domain of {slot.name!r} names a field {name!r}, which {slot.type.__qualname__} "
            f"does not have; it has: {', '.join(fields) or 'none'}{did_you_mean(name, fields)}"
        )
    if given == _EVERY:
        return [msgspec.to_builtins(value) for value in every(fields[name].type)]
    if not isinstance(given, list):
        raise DomainError(
            f"the domain of {slot.name!r} has {given!r} for {name!r}: it must be {_EVERY!r} or a "
            f"list of values"
        )
    return given


def _message(slot: Slot[Any], given: Any) -> Any:
    if given is None or given == _NONE:
        return None
    from llfsm.whiteboard import MessageFieldError
    from llfsm.whiteboard.message_text import parse_message

    try:
        return parse_message(slot, msgspec.json.encode(given))
    except MessageFieldError as error:
        raise DomainError(f"{given!r} in the domain: {error}") from error
