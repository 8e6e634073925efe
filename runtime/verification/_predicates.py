"""Predicates on packed states: each combination of the fields that one reads is evaluated once.

A property's function notes the fields that it reads, by asking a view for them. Their bits are the
key by which its results are kept, so that a level of thousands of states costs a few calls. When a
call reads a further field, the key grows and the results are forgotten. If a field is no part of a
state, because no machine's turn depends on it, the exploration begins again with that field.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from llfsm.runtime._values import Variables
from llfsm.runtime.verification._system import RelearnError
from llfsm.runtime.verification._tables import FieldName, Tables
from llfsm.runtime.verification._twin import States
from llfsm.runtime.verification.environment import ControlState
from llfsm.runtime.verification.errors import PredicateError
from llfsm.runtime.verification.properties import Property, View, evaluate

if TYPE_CHECKING:
    from llfsm.runtime.engine.seat import Seat


class PackedSituation:
    """A packed state as a `Situation`; it notes the fields that it is asked for in `used`."""

    def __init__(self, tables: Tables, state: int, used: set[FieldName]):
        ringlets = tables.system.ringlets
        self.seats: Mapping[str, Seat] = {seat.name: seat for seat in ringlets.seats}
        self.defaults = tables.system.defaults
        self._tables = tables
        self._state = state
        self._used = used

    def control(self, machine: str) -> ControlState:
        """Return a machine's control state."""
        codes = self._tables.system.ringlets.controls[self._place(machine)]
        control: ControlState = codes.values[self._code(("control", machine))]
        return control

    def variables(self, machine: str) -> Mapping[str, Any]:
        """Return a machine's variables."""
        place, system = self._place(machine), self._tables.system
        if not system.shows(place):
            raise UnnamedFieldError
        codes = system.ringlets.variables[place]
        variables: Variables = codes.values[self._code(("variables", machine))]
        return variables[0]

    def seen(self, machine: str, sensor: str) -> Any:
        """Return the message that a machine's sensor found in its last turn; None if none."""
        slot = self._tables.system.reads[self._place(machine)][sensor]
        return self._message(slot, self._code(("seen", f"{machine}.{sensor}")))

    def content(self, slot: str) -> Any:
        """Return the message in a slot; None if it is empty."""
        return self._message(slot, self._code(("slot", slot)))

    def _place(self, machine: str) -> int:
        return self._tables.system.ringlets.places[machine]

    def _message(self, slot: str, code: int) -> Any:
        return self._tables.system.ringlets.messages[slot].values[code] if code else None

    def _code(self, field: FieldName) -> int:
        self._used.add(field)
        if field not in self._tables.fields:
            raise UnnamedFieldError
        return self._tables.fields[field].of(self._state)


class UnnamedFieldError(BaseException):
    """A property reads a field that states lack; no `except Exception` of its may catch it."""


class _HasGrownError(Exception):
    """A function has read a field that keys lacked; now they have it, and nothing is known."""


class Checker:
    """Find the states, or turns, for which a property's function returns `sought`."""

    def __init__(self, prop: Property, function: Callable[..., bool], *, sought: bool):
        self._property = prop
        self._function = function
        self._sought = sought
        self._used: set[FieldName] = set()
        self._named: set[FieldName] = set()

    def restart(self, tables: Tables) -> None:
        """Begin again, with other tables."""
        self._tables = tables
        self._use(tables.packing.mask(self._used))

    def select(self, states: Iterable[int], named: set[FieldName]) -> States:
        """List the states that are sought; add fields that states lack to `named`."""
        return self.part(states, named)[0]

    def part(self, states: Iterable[int], named: set[FieldName]) -> tuple[States, States]:
        """Part states into those that are sought and others, likewise."""
        self._named = named
        if not isinstance(states, States):
            states = self._tables.packing.states(states)
        while True:
            with suppress(_HasGrownError):
                return self._states.split(states)

    def select_pairs(
        self, pairs: Iterable[tuple[int, int]], named: set[FieldName]
    ) -> list[tuple[int, int]]:
        """List the turns that are sought, by the states before and after them."""
        self._named = named
        while True:
            with suppress(_HasGrownError):
                return [pair for pair in pairs if self._is_sought_pair(*pair)]

    def _use(self, mask: int) -> None:
        self._mask = mask
        self._states = self._tables.packing.filter(mask, self._is_sought)
        self._pairs: dict[tuple[int, int], bool] = {}

    def _is_sought_pair(self, before: int, after: int) -> bool:
        key = before & self._mask, after & self._mask
        if key not in self._pairs:
            self._pairs[key] = self._is_sought(*key)
        return self._pairs[key]

    def _is_sought(self, *key: int) -> bool:
        """Evaluate the function; raise `_HasGrownError` if the key lacks a field that it reads."""
        views = [View(PackedSituation(self._tables, s, self._used)) for s in key]
        try:
            value = evaluate(self._property, self._function, *views)
        except UnnamedFieldError:
            self._named.update(self._used - self._tables.fields.keys())
            raise RelearnError from None
        except PredicateError:
            self._check_key()  # without a field, that may be no state: the other fields are 0
            raise
        self._check_key()
        return value is self._sought

    def _check_key(self) -> None:
        """Begin again if the function has read more fields than keys have."""
        mask = self._tables.packing.mask(self._used)
        if mask != self._mask:
            self._use(mask)
            raise _HasGrownError from None
