"""What a property's function sees of a state: `v.Timer.minutes`, `v[MOTOR].on`, `v.Cooker.door`."""

from __future__ import annotations

import dis
import sys
from collections.abc import Callable, Iterable, Mapping
from copy import deepcopy
from types import FrameType
from typing import TYPE_CHECKING, Any, Protocol

from llfsm.errors import did_you_mean

from ..engine.state import State
from .errors import PredicateError

if TYPE_CHECKING:
    from llfsm.whiteboard import Slot

    from ..engine.seat import Seat
    from .standings import ControlState

__all__ = ["MachineView", "Situation", "StateName", "View", "defaults_of"]


class Situation(Protocol):
    """A state of all machines, from which a view takes what it is asked for."""

    seats: Mapping[str, Seat]
    """The machines by name; only what never changes is read from them."""
    defaults: Mapping[str, Any]
    """By slot, what an empty one reads as."""

    def control(self, machine: str) -> ControlState:
        """Return where a machine stands."""
        ...

    def variables(self, machine: str) -> Mapping[str, Any]:
        """Return a machine's variables."""
        ...

    def seen(self, machine: str, sensor: str) -> Any:
        """Return what a machine's sensor found in its last turn; None if nothing."""
        ...

    def content(self, slot: str) -> Any:
        """Return what is in a slot; None before the first message."""
        ...


def defaults_of(seats: Iterable[Seat]) -> dict[str, Any]:
    """Return what a view shows for each slot that machines use, by name, while it is empty.

    It is the default that sensors agree on, or a message of defaults; None if there is neither.
    """
    types: dict[str, Callable[[], Any]] = {}
    given: dict[str, list[Any]] = {}
    for seat in seats:
        table = type(seat.machine).table
        for actuator in table.actuators.values():
            slot = seat.slot_of(actuator)
            types[slot.name] = slot.type
        for sensor in table.sensors.values():
            slot = seat.slot_of(sensor)
            types[slot.name] = slot.type
            if sensor.default is not None:
                given.setdefault(slot.name, []).append(sensor.default)
    defaults: dict[str, Any] = {}
    for name, make in types.items():
        found = given.get(name, [])
        if found and all(other == found[0] for other in found):
            defaults[name] = found[0]
            continue
        try:
            defaults[name] = make()
        except TypeError:  # a field has no default
            defaults[name] = None
    return defaults


class View:
    """A state: its machines by name, as in `v.Timer` or `v["Timer.0"]`, and `v[SLOT]`.

    An empty slot shows the default that sensors agree on, or else a message of its type's defaults;
    None if there is no such message. A slot of the environment shows what a machine found there
    last.
    """

    def __init__(self, situation: Situation):
        self._situation = situation

    def __getattr__(self, name: str) -> MachineView:
        seats = self._situation.seats
        if name not in seats:
            raise PredicateError(
                f"there is no machine {name!r}{did_you_mean(name, seats)}; there are: "
                f"{', '.join(seats)}"
            )
        return MachineView(self._situation, name)

    def __getitem__(self, what: Slot[Any] | str) -> Any:
        if isinstance(what, str) and what in self._situation.seats:
            return MachineView(self._situation, what)
        name = what if isinstance(what, str) else what.name
        defaults = self._situation.defaults
        if name not in defaults:
            raise PredicateError(
                f"no machine reads or posts to a slot {name!r}{did_you_mean(name, defaults)}; the "
                f"slots are: {', '.join(sorted(defaults))}"
            )
        content = self._situation.content(name)
        return defaults[name] if content is None else content


class MachineView:
    """A machine: its `state`, its variables, and what its sensors found in its last turn.

    `suspended` is whether it is in its suspend state, `loaded` whether it is still there, and
    `accepted` whether it has accepted. A state compares with names and with `State` objects; a name
    that the machine's states do not have is an error. So is to look a state up by its hash, but in
    a set of names that is written out, as in `v.Door.state in {"OPEN", "SHUT"}`.
    """

    def __init__(self, situation: Situation, name: str):
        self._situation = situation
        self._name = name

    @property
    def state(self) -> StateName:
        """The name of its current state."""
        control, seat = self._control("state"), self._situation.seats[self._name]
        known = dict.fromkeys([*seat.states, seat.suspension.name])
        return StateName(control.current, self._name, tuple(known))

    @property
    def suspended(self) -> bool:
        """Whether it is in its suspend state."""
        control, seat = self._control("suspended"), self._situation.seats[self._name]
        return control.current == seat.suspension.name

    @property
    def accepted(self) -> bool:
        """Whether it has ended a turn in an accepting state."""
        return self._control("accepted").accepted

    @property
    def loaded(self) -> bool:
        """Whether it has not been unloaded."""
        return self._control("loaded").loaded

    def _control(self, asked: str) -> ControlState:
        table = type(self._situation.seats[self._name].machine).table
        if asked in table.variables or asked in table.sensors:
            raise PredicateError(
                f"{self._name} has {asked!r} of its own, which {self._name}.{asked} does not show: "
                f"call the variable or sensor otherwise"
            )
        return self._situation.control(self._name)

    def __getattr__(self, name: str) -> Any:
        table = type(self._situation.seats[self._name].machine).table
        if name in table.sensors:
            found = self._situation.seen(self._name, name)
            return table.sensors[name].default if found is None else found
        variables = self._situation.variables(self._name)
        if name in variables:
            return deepcopy(variables[name])
        known = ["state", "suspended", "accepted", "loaded", *table.sensors, *variables]
        raise PredicateError(
            f"{self._name} has no {name!r}{did_you_mean(name, known)}; it has: {', '.join(known)}"
        )


class StateName(str):
    """The name of a machine's state, which knows the others."""

    _machine: str
    _known: tuple[str, ...]

    def __new__(cls, name: str, machine: str, known: tuple[str, ...]) -> StateName:
        """Return the name of a state of `machine`, whose states are `known`."""
        made = super().__new__(cls, name)
        made._machine = machine
        made._known = known
        return made

    def __eq__(self, other: object) -> bool:
        if isinstance(other, State):
            other = other.name
        if isinstance(other, str) and not isinstance(other, StateName) and other not in self._known:
            raise PredicateError(
                f"{self._machine} has no state {other!r}{did_you_mean(other, self._known)}; its "
                f"states are: {', '.join(self._known)}"
            )
        return str.__eq__(self, other) is True

    def __ne__(self, other: object) -> bool:
        return not self == other

    def __hash__(self) -> int:
        names = _written_set(sys._getframe(1))
        if names is None:
            raise PredicateError(
                f"a state of {self._machine} is looked up in a set or dict, which takes any name "
                f"for one of no state: compare it by ==, or by `in` with a tuple"
            )
        for name in names:
            self == name  # noqa: B015, which refuses a name of no state
        return str.__hash__(self)


def _written_set(frame: FrameType) -> frozenset[str] | None:
    """Return the names in `... in {"A", "B"}`, if that is what the frame does just now."""
    before: object = None
    for step in dis.get_instructions(frame.f_code):
        if step.offset == frame.f_lasti:
            break
        before = step.argval
    if isinstance(before, frozenset) and all(isinstance(name, str) for name in before):
        return before
    return None
