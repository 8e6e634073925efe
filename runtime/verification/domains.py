"""Domains: what the environment may put into a slot."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from enum import Enum
from itertools import product
from math import prod
from typing import TYPE_CHECKING, Any

import msgspec

from ..engine.domain import MOST, messages_of_domain
from ..engine.errors import DefinitionError
from .errors import DomainError

if TYPE_CHECKING:
    from llfsm.whiteboard import Slot

__all__ = ["every", "messages_of"]


def every(kind: Any) -> tuple[Any, ...]:
    """Return every value of a type, for use as a domain.

    Types are bool, None, enums, literals, integers with both bounds (``Annotated[int,
    msgspec.Meta(ge=0, le=9)]``), and unions, fixed tuples and messages of these. Raise
    `DomainError` for any other type, and for more than 100,000 values.
    """
    try:
        info = msgspec.inspect.type_info(kind)
    except TypeError as error:
        raise DomainError(f"every({_name(kind)}): {error}") from None
    number = _count(info, _name(kind))
    if number > MOST:
        raise DomainError(
            f"every({_name(kind)}) has {number} values: list those that matter, as in "
            f"sensors={{SLOT: [message, ...]}}"
        )
    return tuple(_values(info))


def messages_of(slot: Slot[Any], domain: Iterable[Any], where: str) -> tuple[Any, ...]:
    """Return the messages of a domain for `slot`, each once; raise `DomainError`."""
    try:
        return messages_of_domain(slot, domain)
    except DefinitionError as error:
        raise DomainError(f"{where}: {error}") from error


def _name(kind: Any) -> str:
    return str(getattr(kind, "__qualname__", kind))


def _bounds(info: msgspec.inspect.IntType) -> range | None:
    low = info.ge if info.gt is None else info.gt + 1
    high = info.le if info.lt is None else info.lt - 1
    if low is None or high is None:
        return None
    step = info.multiple_of or 1
    return range(-(-low // step) * step, high + 1, step)


def _count(info: msgspec.inspect.Type, what: str) -> int:
    inspect = msgspec.inspect
    match info:
        case inspect.BoolType():
            return 2
        case inspect.NoneType():
            return 1
        case inspect.EnumType(cls=cls):
            return len(cls)
        case inspect.LiteralType(values=values):
            return len(values)
        case inspect.IntType():
            bounds = _bounds(info)
            if bounds is None:
                raise DomainError(
                    f"every({what}): an int without both bounds has no end of values: annotate "
                    f"it, as in Annotated[int, msgspec.Meta(ge=0, le=9)], or list the messages"
                )
            return len(bounds)
        case inspect.UnionType(types=types):
            return sum(_count(each, what) for each in types)
        case inspect.TupleType(item_types=types):
            return prod(_count(each, what) for each in types)
        case inspect.StructType(fields=fields):
            return prod(_count(f.type, f"{what}.{f.name}") for f in fields)
    kind = type(info).__name__.removesuffix("Type").lower()
    raise DomainError(f"every({what}): a {kind} has no end of values: list the messages instead")


def _values(info: msgspec.inspect.Type) -> Iterator[Any]:
    inspect = msgspec.inspect
    match info:
        case inspect.BoolType():
            yield from (False, True)
        case inspect.NoneType():
            yield None
        case inspect.EnumType(cls=cls):
            members: type[Enum] = cls
            yield from members
        case inspect.LiteralType(values=values):
            yield from values
        case inspect.IntType():
            yield from _bounds(info) or ()
        case inspect.UnionType(types=types):
            for each in types:
                yield from _values(each)
        case inspect.TupleType(item_types=types):
            yield from product(*map(_values, types))
        case inspect.StructType(fields=fields):
            for row in product(*(list(_values(f.type)) for f in fields)):
                yield info.cls(**{f.name: value for f, value in zip(fields, row, strict=True)})
