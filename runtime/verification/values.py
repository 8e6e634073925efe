"""Values of variables and messages as keys: by type and encoded bytes, so that True is not 1."""

from __future__ import annotations

import dataclasses
from collections import deque
from collections.abc import Callable, Collection, Hashable, Iterable
from copy import deepcopy
from enum import Enum
from typing import Any, TypeAlias

import msgspec

from .unordered import plain_kind, shuffled

__all__ = ["Codes", "UnknownValueError", "Variables", "freeze", "message_text", "other_copy"]

_PLAIN = (bool, int, str, bytes, type(None))

Variables: TypeAlias = tuple[dict[str, Any], bool]
"""A machine's variables by name, and whether any has parts that `freeze` notes."""


class UnknownValueError(Exception):
    """A value is not data; the text says what it is."""


class Codes:
    """Number values in the order in which they are found; the same key gets the same number."""

    def __init__(self) -> None:
        self._codes: dict[Hashable, int] = {}
        self.values: list[Any] = []

    def __len__(self) -> int:
        return len(self.values)

    def code(self, key: Hashable, value: Any) -> int:
        """Return the number of `key`; `value` is what stands for it if it is new."""
        code = self._codes.get(key)
        if code is None:
            code = self._codes[key] = len(self.values)
            self.values.append(value)
        return code


def freeze(value: Any, note: Callable[[Any], None]) -> Hashable:
    """Return the key of a value; call `note` with each part that can change, or is a frozenset.

    Raise `UnknownValueError` for what is not data, such as a function or a file.
    """
    kind = plain_kind(value)
    if kind in _PLAIN:
        return kind, value
    if kind is float:
        return kind, value.hex()  # which differs for NaN, -0.0 and 0.0
    if isinstance(value, Enum):
        return kind, value.name, None if value.name is not None else value.value
    if isinstance(value, tuple):
        _check_fields(value, ())
        return kind, _freeze_all(value, note)
    if isinstance(value, frozenset):
        _check_fields(value, ())
        note(value)
        return kind, frozenset(_freeze_all(value, note))
    if isinstance(value, msgspec.Struct):
        _check_fields(value, value.__struct_fields__)
        if not value.__struct_config__.frozen:
            note(value)
        return kind, _freeze_all((getattr(value, f) for f in value.__struct_fields__), note)
    note(value)
    if kind is list:
        return kind, _freeze_all(value, note)
    if kind is deque:
        return kind, value.maxlen, _freeze_all(value, note)
    if kind is set:
        return kind, frozenset(_freeze_all(value, note))
    if kind is dict:
        return kind, _freeze_all((part for item in value.items() for part in item), note)
    if kind is bytearray:
        return kind, bytes(value)
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        names = [field.name for field in dataclasses.fields(value)]
        _check_fields(value, names)
        return kind, _freeze_all((getattr(value, name) for name in names), note)
    raise UnknownValueError(f"a {kind.__qualname__}")


def other_copy(value: Any) -> Any:
    """Return a deep copy of data in which each set comes in another order every time."""
    sets: dict[int, Any] = {}

    def note(part: Any) -> None:
        if isinstance(part, set | frozenset):
            sets[id(part)] = shuffled(part)

    freeze(value, note)
    return deepcopy(value, sets)  # which are taken for copies that were made


def _check_fields(value: object, names: Collection[str]) -> None:
    for name in getattr(value, "__dict__", ()):
        if name not in names:
            raise UnknownValueError(
                f"a {type(value).__qualname__} with {name!r}, which is not a field"
            )


def _freeze_all(values: Iterable[Any], note: Callable[[Any], None]) -> tuple[Hashable, ...]:
    return tuple([freeze(value, note) for value in values])


def message_text(name: str, message: Any) -> str:
    """Return a message in short, after the name of its slot or sensor."""
    if message is None:
        return f"{name}: no message"
    fields = [f"{field}={getattr(message, field)!r}" for field in message.__struct_fields__]
    return f"{name}.{fields[0]}" if len(fields) == 1 else f"{name}({', '.join(fields)})"
