"""Sets that come in another order every time: code must not depend on it.

The order of a set is that of its elements' hashes, which Python draws anew for texts in each
process, and of its history. It is not part of a state.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator
from typing import Any, Final

__all__ = ["plain_kind", "shuffled"]

_MAKING: Final = (
    *("copy", "union", "intersection", "difference", "symmetric_difference"),
    *("__or__", "__and__", "__sub__", "__xor__", "__ror__", "__rand__", "__rsub__", "__rxor__"),
)
"""The methods that return another set."""
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
_PLAIN: Final[dict[Any, Any]] = {kind: base for base, kind in _SHUFFLED.items()}


def shuffled(value: Any) -> Any:
    """Return a copy of a set that comes in another order every time; others are as they are."""
    kind = _SHUFFLED.get(type(value))
    return value if kind is None else kind(value)


def plain_kind(value: Any) -> Any:
    """Return the type of a value, for a shuffled set that of the set."""
    return _PLAIN.get(type(value), type(value))
