"""The subject of an exploration: its machines, and the domains of what their sensors may read.

A machine is given by its class, by a function that makes it, or as a `Member` with its name,
variables and slots. A domain lists the messages that the environment may put into a slot: made by
`every` of a type, or as an arrangement file or a command line has it (`domain_of`).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from enum import EJECT, KEEP, Enum, Flag
from functools import lru_cache
from itertools import chain, product
from math import prod
from types import MemberDescriptorType
from typing import TYPE_CHECKING, Any, Final, NamedTuple, TypeVar, overload

import msgspec

from llfsm.errors import did_you_mean
from llfsm.runtime._values import UnknownValueError, freeze
from llfsm.runtime.engine.errors import DefinitionError
from llfsm.runtime.engine.kernel import Factory
from llfsm.runtime.engine.machine import Machine, MachineType
from llfsm.runtime.engine.ports import MOST, messages_of_domain
from llfsm.runtime.verification.errors import DomainError, UnsupportedError

if TYPE_CHECKING:
    from llfsm.runtime.engine.kernel import Control
    from llfsm.whiteboard import Slot

T = TypeVar("T")


@overload
def every(kind: type[T]) -> tuple[T, ...]: ...
@overload
def every(kind: Any) -> tuple[Any, ...]: ...
def every(kind: Any) -> tuple[Any, ...]:
    """List every value of a type, each once, for use as a domain: all that a board would accept.

    Types are bool, None, enums, literals, integers with both bounds (``Annotated[int,
    msgspec.Meta(ge=0, le=9)]``), and unions, fixed tuples and messages of these. A flag has all its
    combinations, also none. Raise `DomainError` for any other type, and for more than 100,000
    values.
    """
    name = _name(kind)
    try:
        info = msgspec.inspect.type_info(kind)
        number = _count(info, name)
        if number > MOST:
            raise DomainError(
                f"every({name}) has {number} values: list those that matter, as in "
                f"sensors={{SLOT: [message, ...]}}"
            )
        return _values(info, name)
    except (TypeError, ValueError) as error:
        raise DomainError(f"every({name}): {error}") from error
    except RecursionError:
        raise DomainError(f"every({name}): it contains itself, so it {_ENDLESS}") from None


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


_ENDLESS: Final = "has too many values to list: list the messages that matter instead"


def _count(info: msgspec.inspect.Type, what: str) -> int:
    """Count the values of a type, some twice; raise `DomainError` if there is no list of them."""
    inspect = msgspec.inspect
    match info:
        case inspect.Metadata(type=inner):
            return _count(inner, what)
        case inspect.BoolType():
            return 2
        case inspect.NoneType():
            return 1
        case inspect.EnumType(cls=cls):
            return _count_members(cls, what)
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
            numbers = [each for each in types if isinstance(each, inspect.IntType)]
            if len(numbers) > 1 or (numbers and any(_has_number(each) for each in types)):
                raise DomainError(
                    f"every({what}): what a board accepts for an int of two ranges is not their "
                    f"union: declare one range, or list the messages that matter"
                )
            return sum(_count(each, what) for each in types)
        case inspect.TupleType(item_types=types):
            return prod(_count(each, what) for each in types)
        case inspect.StructType(fields=fields):
            return prod(_count(f.type, f"{what}.{f.name}") for f in fields)
    kind = getattr(info, "cls", None)
    text = type(info).__name__.removesuffix("Type").lower() if kind is None else _name(kind)
    raise DomainError(f"every({what}): the type {text} {_ENDLESS}")


def _has_number(info: msgspec.inspect.Type) -> bool:
    values = info.values if isinstance(info, msgspec.inspect.LiteralType) else ()
    return any(type(value) is int for value in values)


def _count_members(cls: type[Enum], what: str) -> int:
    """Count what a board takes for a member, for which it asks the class, too (`_missing_`)."""
    known = Flag if issubclass(cls, Flag) else Enum
    if getattr(cls._missing_, "__func__", None) is not vars(known)["_missing_"].__func__:
        raise DomainError(
            f"every({what}): {cls.__qualname__}._missing_ may accept more than its members: list "
            f"the messages that matter instead"
        )
    if not issubclass(cls, Flag):
        return len(cls)
    if getattr(cls, "_boundary_") in (KEEP, EJECT):  # noqa: B009, of which typeshed says nothing
        raise DomainError(
            f"every({what}): {cls.__qualname__} accepts any number: declare it with "
            f"boundary=enum.STRICT, or list the messages that matter"
        )
    return 1 << _mask_of(cls).bit_count()


def _mask_of(cls: type[Flag]) -> int:
    mask: int = getattr(cls, "_flag_mask_")  # noqa: B009, of which typeshed says nothing
    return mask


def _members(cls: type[Enum]) -> Iterator[Enum]:
    if not issubclass(cls, Flag):
        yield from cls
        return
    mask = number = _mask_of(cls)
    while True:  # through all numbers that have no bits but those of the mask
        with suppress(ValueError):  # as half of a name of two bits
            yield cls(mask ^ number)
        if number == 0:
            return
        number = (number - 1) & mask


def _values(info: msgspec.inspect.Type, what: str) -> tuple[Any, ...]:
    """List the values of a type that `_count` could count, each once."""
    inspect = msgspec.inspect
    found: Iterable[Any] = ()
    match info:
        case inspect.Metadata(type=inner):
            return _values(inner, what)
        case inspect.BoolType():
            found = (False, True)
        case inspect.NoneType():
            found = (None,)
        case inspect.EnumType(cls=cls):
            found = _members(cls)
        case inspect.LiteralType(values=values):
            found = values
        case inspect.IntType():
            found = _bounds(info) or ()
        case inspect.UnionType(types=types):
            found = chain(*(_values(each, what) for each in types))
        case inspect.TupleType(item_types=types):
            found = product(*(_values(each, what) for each in types))
        case inspect.StructType(fields=fields):
            rows = product(*(_field_domain(f, f"{what}.{f.name}") for f in fields))
            found = _made(info.cls, [f.name for f in fields], rows)
    return tuple({freeze(value): value for value in found}.values())


def _field_domain(field: msgspec.inspect.Field, what: str) -> tuple[Any, ...]:
    """List the values of a field; raise `DomainError` if its default is none of them.

    A board reads the default, of whatever type, where the fields at the end are left out.
    """
    found, default = _values(field.type, what), field.default
    if field.default_factory is not msgspec.NODEFAULT:
        default = field.default_factory()
    if default is not msgspec.NODEFAULT and not _is_in(default, found):
        raise DomainError(
            f"every({what}): its default {default!r} is not of its type: change it, or list the "
            f"messages that matter"
        )
    return found


def _is_in(value: Any, found: Iterable[Any]) -> bool:
    try:
        return freeze(value) in map(freeze, found)
    except UnknownValueError:
        return False


def _made(cls: type, names: list[str], rows: Iterable[tuple[Any, ...]]) -> Iterator[Any]:
    for row in rows:
        with suppress(TypeError, ValueError):  # of `__post_init__`, by which a board refuses, too
            yield cls(**dict(zip(names, row, strict=True)))


_SUSPENDED = "Suspended"
_CACHED = type(lru_cache(lambda: None))


def statuses_of(
    name: str, given: type[Machine] | Iterable[str | None]
) -> tuple[tuple[str, bool] | None, ...]:
    """List the states that a machine of another process may be in, and whether it is suspended.

    A class stands for its states. In a list, None is for a machine that is not there. Raise
    `DomainError` for anything else.
    """
    if isinstance(given, MachineType):
        suspend = given.table.suspend
        last = _SUSPENDED if suspend is None else suspend.name
        states: list[str | None] = [state.name for state in given.table.states]
        states += [] if suspend else [last]
    else:
        is_list = isinstance(given, Iterable) and not isinstance(given, str)
        last, states = _SUSPENDED, [*given] if is_list else []
    if not states or not all(state is None or isinstance(state, str) for state in states):
        raise DomainError(
            f"elsewhere: {name} is declared as {given!r}: give its class, or a list of the states "
            f"that it may be in, {last!r} if it is suspended, and None if it is not there"
        )
    return tuple(None if state is None else (state, state == last) for state in states)


class Member(NamedTuple):
    """A machine to explore: its class, or a function that makes it, and how it is loaded.

    `name`, `variables` and `slots` are as for `Arrangement.load`; a `suspended` one is loaded in
    its suspend state. Without a timetable, suspended members come after the others.
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


def members_of(
    machines: Factory | Member | Iterable[Factory | Member], *, sort: bool = True
) -> tuple[Member, ...]:
    """Make a `Member` of each machine, in order; raise `UnsupportedError` for anything else.

    Those that are suspended come last, as in runs without a timetable, unless not to `sort`.
    """
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
    return tuple(sorted(members, key=lambda member: sort and member.suspended))


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
    info: Any = msgspec.inspect.type_info(slot.type)
    fields = {field.encode_name: field for field in info.fields}
    if name not in fields:
        raise DomainError(
            f"the domain of {slot.name!r} names a field {name!r}, which {slot.type.__qualname__} "
            f"does not have; it has: {', '.join(fields) or 'none'}{did_you_mean(name, fields)}"
        )
    if given == _EVERY:
        what = f"{slot.type.__qualname__}.{name}"
        if _count(fields[name].type, what) > MOST:
            raise DomainError(f"every({what}): its type {_ENDLESS}")
        return [msgspec.to_builtins(value) for value in _field_domain(fields[name], what)]
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
