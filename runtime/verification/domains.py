"""The subject of an exploration: its machines, and the domains of what their sensors may read.

A machine is given by its class, by a function that makes it, or as a `Member` with its name,
variables and slots. A domain lists the messages that the environment may put into a slot: made by
`every` of a type, or as an arrangement file or a command line has it (`domain_of`).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from enum import Enum
from functools import lru_cache
from itertools import product
from math import prod
from types import MemberDescriptorType
from typing import TYPE_CHECKING, Any, NamedTuple

import msgspec

from llfsm.errors import did_you_mean
from llfsm.runtime.engine.errors import DefinitionError
from llfsm.runtime.engine.kernel import Factory
from llfsm.runtime.engine.machine import Machine
from llfsm.runtime.engine.ports import MOST, messages_of_domain
from llfsm.runtime.verification.errors import DomainError, UnsupportedError

if TYPE_CHECKING:
    from llfsm.runtime.engine.kernel import Control
    from llfsm.whiteboard import Slot


def every(kind: Any) -> tuple[Any, ...]:
    """List every value of a type, for use as a domain.

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
    """List the messages of a domain for `slot`, each once; raise `DomainError` for a wrong one."""
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


_SUSPENDED = "Suspended"
_CACHED = type(lru_cache(lambda: None))


class Member(NamedTuple):
    """A machine to explore: its class, or a function that makes it, and how it is loaded.

    `name`, `variables` and `slots` are as for `Arrangement.load`; a `suspended` one is loaded in
    its suspend state. Suspended members come after the others.
    """

    machine: Factory
    name: str | None = None
    variables: Mapping[str, Any] = {}
    slots: Mapping[str, str] = {}
    suspended: bool = False

    def load(self, control: Control) -> None:
        """Load a new machine into the arrangement of `control`."""
        made: Any = self.machine
        if not (isinstance(made, type) and issubclass(made, Machine)):
            made = made()
        load = control.load_suspended if self.suspended else control.load
        load(made, name=self.name, variables=self.variables or None, slots=self.slots)


def require_explorable(cls: type[Machine]) -> None:
    """Raise `UnsupportedError` for a class that keeps state elsewhere than in variables."""
    table = cls.table
    if table.suspend is None and any(state.name == _SUSPENDED for state in table.states):
        raise UnsupportedError(
            f"{cls.__qualname__} has a state {_SUSPENDED!r} but declares no suspend state, which "
            f"then gets the same name: rename it, or make it State(suspend=True)"
        )
    for base in cls.__mro__[: cls.__mro__.index(Machine)]:
        for name, value in vars(base).items():
            if isinstance(value, _CACHED):
                raise UnsupportedError(
                    f"{cls.__qualname__}.{name} keeps results from one call for the next: that is "
                    f"no part of a state, so this cannot be explored; keep them in a variable"
                )
            if isinstance(value, MemberDescriptorType):
                raise UnsupportedError(
                    f"{cls.__qualname__}.{name} is in __slots__, so it is no variable of the "
                    f"machine, and this cannot be explored: remove __slots__"
                )


def members_of(machines: Factory | Member | Iterable[Factory | Member]) -> tuple[Member, ...]:
    """Make a `Member` of each machine, in order; raise `UnsupportedError` for anything else."""
    one = callable(machines) or isinstance(machines, Machine | Member)
    listed: list[Any] = [machines] if one else list(machines)  # type: ignore[arg-type]
    members = [each if isinstance(each, Member) else Member(each) for each in listed]
    for member in members:
        if not callable(member.machine):
            raise UnsupportedError(
                f"{member.machine!r} is neither a machine class nor a function that returns a "
                f"machine: give the class, or lambda: Class(variable=value)"
            )
    if not members:
        raise UnsupportedError("there are no machines to explore")
    return tuple(sorted(members, key=lambda member: member.suspended))


_EVERY, _NONE = "every", "none"


def domain_of(slot: Slot[Any], given: Any) -> tuple[Any, ...]:
    """List the messages of a domain for `slot`, given as "every", a list of messages, or a table.

    A message is a table of its fields, and "none" is no message. A table maps fields to "every" or
    to lists of values: the domain has all combinations. Fields that are left out are zero, empty or
    false. Raise `DomainError` for anything else.
    """
    if given == _EVERY:
        return every(slot.type)
    if isinstance(given, Mapping):
        names = list(given)
        values = [_field_values(slot, name, each) for name, each in given.items()]
        given = [dict(zip(names, row, strict=True)) for row in product(*values)]
    if not isinstance(given, list):
        raise DomainError(
            f"the domain of {slot.name!r} is {given!r}: it must be {_EVERY!r}, a list of messages, "
            f'or a table of fields, as in {{"level": [0, 9]}}'
        )
    return tuple(_message(slot, each) for each in given)


def _field_values(slot: Slot[Any], name: str, given: Any) -> list[Any]:
    """List the values of a field, as plain data."""
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
