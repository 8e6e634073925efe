"""Machines that run are viewed as explored ones are, and replay what was found."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from copy import deepcopy
from typing import TYPE_CHECKING, Any

from ..engine.events import Event, Observer, RoundEnd, Turn
from ..testing.playback import Playback
from ..verification.standings import ControlState
from ..verification.state_view import View, defaults_of
from .regression import script_of

if TYPE_CHECKING:
    from ..engine.seat import Seat
    from ..testing.scripted import ScriptedEnvironment
    from ..verification.space import Space
    from ..verification.witness import Witness

__all__ = ["LiveSituation", "replay", "situation_of", "view_of"]


def replay(space: Space, witness: Witness, *, observers: Iterable[Observer] = ()) -> list[View]:
    """Play a way on new machines, under a `ManualClock`.

    Return a view of the initial state, and one of the state after each turn; raise what code
    raises, as `Arrangement.round` does.
    """
    playback = Playback(space.members, unload_accepting=space.unload_accepting)
    views = [view_of(playback.scripted)]
    turn = False

    def look(event: Event) -> None:
        nonlocal turn
        if isinstance(event, Turn | RoundEnd):
            if turn:
                views.append(view_of(playback.scripted))
            turn = isinstance(event, Turn)

    for observer in (look, *observers):
        playback.arrangement.attach(observer)
    for _ in playback.play(script_of(witness, space.slots)):
        pass
    if playback.error is not None:
        raise playback.error
    return views


def view_of(environment: ScriptedEnvironment) -> View:
    """Return a view of the state in which machines are now."""
    return View(situation_of(environment))


def situation_of(environment: ScriptedEnvironment) -> LiveSituation:
    """Return the state in which machines are now, those that have left included."""
    seats = {name: machine._seat for name, machine in environment.machines.items()}
    contents: dict[str, Any] = {}
    for seat in seats.values():
        table = type(seat.machine).table
        ports: list[Any] = [*table.sensors.values(), *table.actuators.values()]
        for slot in map(seat.slot_of, ports):
            contents[slot.name] = environment.content(slot)
    return LiveSituation(seats, contents, defaults_of(seats.values()))


class LiveSituation:
    """The state of machines that run, taken when it is made; `contents` are those of the slots."""

    def __init__(
        self,
        seats: Mapping[str, Seat],
        contents: Mapping[str, Any],
        defaults: Mapping[str, Any],
    ):
        self.seats = seats
        self.defaults = defaults
        self._contents = contents
        self._controls = {name: ControlState.of(seat) for name, seat in seats.items()}
        self._variables, self._seen = {}, {}
        for name, seat in seats.items():
            attributes, table = vars(seat.machine), type(seat.machine).table
            hidden = {*table.sensors, *table.actuators, "stopping"}
            own = {each: value for each, value in attributes.items() if each not in hidden}
            self._variables[name] = deepcopy(own)
            self._seen[name] = {sensor: attributes.get(sensor) for sensor in table.sensors}

    def control(self, machine: str) -> ControlState:
        """Return where a machine stands."""
        return self._controls[machine]

    def variables(self, machine: str) -> Mapping[str, Any]:
        """Return a machine's variables."""
        return self._variables[machine]

    def seen(self, machine: str, sensor: str) -> Any:
        """Return what a machine's sensor found in its last turn."""
        return self._seen[machine][sensor]

    def content(self, slot: str) -> Any:
        """Return what is in a slot."""
        return self._contents[slot]
