"""Packed states by the thousand: lists and sets of them, and tables of what becomes of them.

A state is a whole number, less than 2 to the power of 64 * words - 1. All that is done with many
states at once is done here, so that a twin in C (`_states.c`) can do it with plain memory: there, a
state is some words, a set of states a table with open addressing, and the effects of a turn an
array. The order is defined, for the same counterexamples on both sides: what comes first stays
first.

`_twin` chooses which are used. The definitions take the same arguments, and need no `words`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any, TypeAlias

Effect: TypeAlias = tuple[int, int]
"""Bits of a state to keep, and bits to put there: `state & keep | put` is the state after it."""
Fill: TypeAlias = Callable[[int], tuple[int, tuple[Effect, ...]]]
"""Find what belongs to a key: its weight, and its effects."""


class States(list[int]):
    """A list of packed states."""

    def __init__(self, words: int, states: Iterable[int] = ()):
        super().__init__(states)
        self._words = words

    def __getitem__(self, key: Any) -> Any:
        """Return a state, or `States` of a slice."""
        found = super().__getitem__(key)
        return States(self._words, found) if isinstance(key, slice) else found


class Seen:
    """A set of packed states."""

    def __init__(self, words: int):
        self._states: set[int] = set()

    def __len__(self) -> int:
        return len(self._states)

    def add(self, states: Sequence[int], found: list[int]) -> None:
        """Add states; append each that is new to `found`."""
        new = [s for s in dict.fromkeys(states) if s not in self._states]
        self._states.update(new)
        found += new


class EffectTable:
    """The effects on states by some of their bits, `mask`: `fill` is called once for each key.

    An exception that `fill` raises is passed on, and leaves the table as it was.
    """

    def __init__(self, words: int, mask: int, fill: Fill):
        self._words = words
        self._mask = mask
        self._fill = fill
        self._effects: dict[int, tuple[Effect, ...]] = {}
        self._weights: dict[int, int] = {}

    def apply(self, states: Sequence[int]) -> tuple[States, int]:
        """List what comes of each state by each of its effects; add up the states' weights."""
        mask, effects, weights = self._mask, self._effects, self._weights
        keys = [s & mask for s in states]
        self._look_up(keys)
        after = [s & keep | put for s in states for keep, put in effects[s & mask]]
        return States(self._words, after), sum(map(weights.__getitem__, keys))

    def split(self, states: Sequence[int]) -> tuple[States, States]:
        """Part the states that have effects from those that have none."""
        mask, effects = self._mask, self._effects
        self._look_up([s & mask for s in states])
        some = States(self._words, (s for s in states if effects[s & mask]))
        return some, States(self._words, (s for s in states if not effects[s & mask]))

    def effects(self, state: int) -> tuple[Effect, ...]:
        """List the effects on a state."""
        key = state & self._mask
        self._look_up([key])
        return self._effects[key]

    def _look_up(self, keys: list[int]) -> None:
        for key in dict.fromkeys(keys):
            if key not in self._effects:
                self._weights[key], self._effects[key] = self._fill(key)
