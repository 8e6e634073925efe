"""Predicates on packed states: each combination of the fields that one reads is evaluated once.

A property's function notes the fields that it reads, by asking a view for them. Their bits are the
key by which its results are kept, so that a level of thousands of states costs a few calls. When a
call reads a further field, the key grows and the results are forgotten. If a field is no part of a
state, because no machine's turn depends on it, the exploration begins again with that field.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Mapping
from typing import TYPE_CHECKING, Any

from llfsm.runtime.verification._system import RelearnError
from llfsm.runtime.verification._tables import FieldName, Tables
from llfsm.runtime.verification.environment import ControlState
from llfsm.runtime.verification.errors import PredicateError
from llfsm.runtime.verification.properties import Property, View, evaluate
from llfsm.runtime.verification.values import Variables

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
        codes = self._tables.system.ringlets.variables[self._place(machine)]
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


class Checker:
    """Find the states, or turns, for which a property's function returns `sought`."""

    def __init__(self, prop: Property, function: Callable[..., bool], *, sought: bool):
        self._property = prop
        self._function = function
        self._sought = sought
        self._used: set[FieldName] = set()
        self._found: set[Hashable] = set()  # the combinations that are sought
        self._others: set[Hashable] = set()  # those that were looked at and are not

    def restart(self, tables: Tables) -> None:
        """Begin again, with other tables."""
        self._tables = tables
        self._use(tables.packing.mask(self._used))

    def select(self, states: Iterable[int], named: set[FieldName]) -> list[int]:
        """List the states that are sought; add fields that states lack to `named`."""
        while not self._look({s & self._mask for s in states}, named):
            pass
        if not self._found:
            return []
        mask, found = self._mask, self._found
        return [s for s in states if s & mask in found]

    def select_pairs(
        self, pairs: Iterable[tuple[int, int]], named: set[FieldName]
    ) -> list[tuple[int, int]]:
        """List the turns that are sought, by the states before and after them."""
        while not self._look({(s & self._mask, t & self._mask) for s, t in pairs}, named):
            pass
        if not self._found:
            return []
        mask, found = self._mask, self._found
        return [(s, t) for s, t in pairs if (s & mask, t & mask) in found]

    def _use(self, mask: int) -> None:
        self._mask = mask
        self._found, self._others = set(), set()

    def _has_grown(self) -> bool:
        """Begin again if the function has read more fields than keys have."""
        mask = self._tables.packing.mask(self._used)
        grown = mask != self._mask
        if grown:
            self._use(mask)
        return grown

    def _look(self, keys: set[Any], named: set[FieldName]) -> bool:
        """Evaluate the function for new keys; return False if they lack a field that it reads."""
        for key in keys - self._others - self._found:
            each = (key,) if isinstance(key, int) else key
            views = [View(PackedSituation(self._tables, s, self._used)) for s in each]
            try:
                value = evaluate(self._property, self._function, *views)
            except UnnamedFieldError:
                named.update(self._used - self._tables.fields.keys())
                raise RelearnError from None
            except PredicateError:
                if not self._has_grown():  # else that may be no state: the other fields are 0
                    raise
                return False
            if self._has_grown():
                return False
            (self._found if value is self._sought else self._others).add(key)
        return True
