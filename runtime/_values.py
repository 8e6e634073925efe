"""Values of variables and messages: as keys that number them, and as copies with shuffled sets.

A state has numbers in place of values. Two values have the same number if their keys are equal; a
key has the type with each part, so that True is not 1, and 0.0 is not -0.0.

The order of a set is that of its elements' hashes, which Python draws anew for texts in each
process, and of its history. It is not part of a state, so code must not depend on it: where
ringlets are run again, they get *shuffled sets*, which come in another order every time.
"""

from __future__ import annotations

import dataclasses
import random
from collections import Counter, deque
from collections.abc import Callable, Hashable, Iterable, Iterator
from contextlib import suppress
from copy import deepcopy
from enum import Enum, Flag
from functools import cache
from types import (
    GetSetDescriptorType,
    MemberDescriptorType,
    MethodDescriptorType,
    WrapperDescriptorType,
)
from typing import Any, Final, TypeAlias

import msgspec

_MAKING: Final = (
    *("copy", "union", "intersection", "difference", "symmetric_difference"),
    *("__or__", "__and__", "__sub__", "__xor__", "__ror__", "__rand__", "__rsub__", "__rxor__"),
)
"""The methods of a set that return another one, which is then shuffled, too."""
_chance = random.Random(0)


def _iterated(base: Any) -> Callable[[Any], Iterator[Any]]:
    def iterate(self: Any) -> Iterator[Any]:
        each = list(base.__iter__(self))
        _chance.shuffle(each)
        for item in each:
            yield item
            if len(self) != len(each):
                raise RuntimeError("Set changed size during iteration")

    return iterate


def _making(method: Callable[..., Any]) -> Callable[..., Any]:
    def make(self: Any, *others: Any) -> Any:
        made = method(self, *others)
        return made if made is NotImplemented else shuffled(made)

    return make


def _pop(self: set[Any]) -> Any:
    if not self:
        return set.pop(self)  # which raises
    item = next(iter(self))
    self.remove(item)
    return item


def _kind(base: type, **methods: Any) -> type:
    methods |= {name: _making(getattr(base, name)) for name in _MAKING}
    methods |= {"__iter__": _iterated(base), "__repr__": lambda self: repr(base(self))}
    return type(base.__name__, (base,), methods)


_SHUFFLED: Final[dict[Any, Any]] = {set: _kind(set, pop=_pop), frozenset: _kind(frozenset)}
_UNSHUFFLED: Final[dict[Any, Any]] = {kind: base for base, kind in _SHUFFLED.items()}


def shuffled(value: Any) -> Any:
    """Copy a set so that it comes in another order every time; return others as they are."""
    kind = _SHUFFLED.get(type(value))
    return value if kind is None else kind(value)


def plain_kind(value: Any) -> Any:
    """Return the type of a value; of a shuffled set that of the set."""
    return _UNSHUFFLED.get(type(value), type(value))


PLAIN: Final = frozenset((bool, int, str, bytes, type(None)))
"""The types whose values are part of a key as they are."""
_IN_C = (WrapperDescriptorType, MethodDescriptorType, GetSetDescriptorType)
"""The methods and attributes of classes in C, of which nobody knows what their values keep."""
_PYTHONS = ("__dict__", "__weakref__")
"""Those that every class has."""

Variables: TypeAlias = tuple[dict[str, Any], bool]
"""A machine's variables by name, and True if any has parts that `freeze` notes."""


class UnknownValueError(Exception):
    """A value is not data; the text names its type."""


class Codes:
    """Number values in the order in which they are found; the same key gets the same number."""

    def __init__(self) -> None:
        self._codes: dict[Hashable, int] = {}
        self.values: list[Any] = []

    def __len__(self) -> int:
        return len(self.values)

    def keys(self) -> Iterator[Any]:
        """Yield the keys in the order of their numbers."""
        yield from self._codes

    def code(self, key: Hashable, value: Any) -> int:
        """Give `key` its number; if it is new, keep `value` for it in `values`."""
        code = self._codes.get(key)
        if code is None:
            code = self._codes[key] = len(self.values)
            self.values.append(value)
        return code


def _ignore(_: Any) -> None:
    """Note nothing."""


def freeze(value: Any, note: Callable[[Any], None] = _ignore) -> Hashable:
    """Make the key of a value; call `note` with each part that can change, or is a frozenset.

    Raise `UnknownValueError` for what is not data, such as a function or a file, and for data with
    more to it than its key would tell.
    """
    kind = plain_kind(value)
    if kind in PLAIN:
        return kind, value
    if kind is float:
        return kind, value.hex()  # which differs for NaN, -0.0 and 0.0
    if isinstance(value, Enum):
        return _freeze_member(kind, value)
    if isinstance(value, tuple):
        return kind, _kept(value, tuple, (), note), _freeze_all(tuple.__iter__(value), note)
    if isinstance(value, frozenset):
        note(value)
        return kind, _kept(value, frozenset, (), note), _freeze_set(frozenset.__iter__(value), note)
    if isinstance(value, msgspec.Struct):
        if not value.__struct_config__.frozen:
            note(value)
        return kind, _kept(value, msgspec.Struct, value.__struct_fields__, note)
    note(value)
    if kind is list:
        return kind, _freeze_all(value, note)
    if kind is deque:
        return kind, value.maxlen, _freeze_all(value, note)
    if kind is set:
        return kind, _freeze_set(set.__iter__(value), note)
    if kind is dict:
        return kind, _freeze_all((part for item in value.items() for part in item), note)
    if kind is bytearray:
        return kind, bytes(value)
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        names = tuple(field.name for field in dataclasses.fields(value))
        return kind, _kept(value, object, names, note)
    raise UnknownValueError(f"a {kind.__qualname__}")


def own_copy(value: Any) -> Any:
    """Copy data deeply; raise `UnknownValueError` if its class makes something else of that."""
    copied = deepcopy(value)
    parts: list[Any] = []
    others: list[Any] = []
    same = freeze(value, parts.append) == freeze(copied, others.append)
    ids = {id(part) for part in others if not isinstance(part, frozenset)}
    if not same or not ids.isdisjoint(map(id, parts)):
        raise UnknownValueError(f"a {type(value).__qualname__}, whose copies are not its equals")
    return copied


def other_copy(value: Any) -> Any:
    """Copy data deeply, with shuffled sets."""
    sets: dict[int, Any] = {}

    def note(part: Any) -> None:
        if isinstance(part, set | frozenset):
            sets[id(part)] = shuffled(part)

    freeze(value, note)
    return deepcopy(value, sets)  # which are taken for copies that were made


def _freeze_member(kind: type[Enum], member: Enum) -> Hashable:
    """Make the key of a member of an enum; a flag has more than those that have names."""
    if kind.__members__.get(member._name_) is member:
        return kind, member._name_
    if isinstance(member, Flag):
        return kind, member._value_, None
    raise UnknownValueError(f"a {kind.__qualname__} that is not among its members")


def _kept(
    value: Any, base: type, names: tuple[str, ...], note: Callable[[Any], None]
) -> tuple[Hashable, ...]:
    """Make keys of all that a value has beside what its `base` has: the fields `names`."""
    own = getattr(value, "__dict__", {})
    for name in own:
        if name not in names:
            raise UnknownValueError(
                f"a {type(value).__qualname__} with {name!r}, which is not a field"
            )
    parts = [*own.items()]  # in their order, which `vars` shows
    for name, place in _places(plain_kind(value), base, names):
        with suppress(AttributeError):  # it is empty
            parts.append((name, place.__get__(value)))
    return tuple([(name, freeze(part, note)) for name, part in parts])


@cache
def _places(
    kind: type, base: type, names: tuple[str, ...]
) -> tuple[tuple[str, MemberDescriptorType], ...]:
    """List the places of values of a class, as `__slots__` makes them, beside those of `base`.

    Raise `UnknownValueError` if there is more to them than these, and than attributes.
    """
    places: list[tuple[str, MemberDescriptorType]] = []
    what = f"a {kind.__qualname__}"
    for cls in kind.__mro__:
        if cls in base.__mro__:
            continue
        for name, value in vars(cls).items():
            if isinstance(value, MemberDescriptorType):
                if name not in names:
                    raise UnknownValueError(f"{what} with {name!r}, which is not a field")
                places.append((name, value))
            elif name == "__getattribute__" or (name in names and hasattr(value, "__set__")):
                raise UnknownValueError(f"{what} with a {name!r} of its own")
            elif isinstance(value, _IN_C) and value.__objclass__ is cls and name not in _PYTHONS:
                raise UnknownValueError(f"{what}, which is a {cls.__qualname__}, too")
    return tuple(places)


def _freeze_set(values: Iterable[Any], note: Callable[[Any], None]) -> Hashable:
    """Make the key of a set, in which unequal values may have equal keys, such as NaN."""
    return frozenset(Counter(freeze(value, note) for value in values).items())


def _freeze_all(values: Iterable[Any], note: Callable[[Any], None]) -> tuple[Hashable, ...]:
    return tuple([freeze(value, note) for value in values])


def message_text(name: str, message: Any) -> str:
    """Write a message in short, after the name of its slot or sensor."""
    if message is None:
        return f"{name}: no message"
    fields = [f"{field}={getattr(message, field)!r}" for field in message.__struct_fields__]
    return f"{name}.{fields[0]}" if len(fields) == 1 else f"{name}({', '.join(fields)})"
