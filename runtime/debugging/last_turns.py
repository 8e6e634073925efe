"""What machines' transitions were when they were evaluated last, and what they saw."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from llfsm.runtime.engine.events import Eval, Event, Section, Turn

if TYPE_CHECKING:
    from llfsm.runtime.engine.arrangement import Arrangement
    from llfsm.runtime.engine.binding import BoundState, BoundTransition
    from llfsm.runtime.engine.seat import Seat

__all__ = ["LastTurn", "LastTurns"]

_COPIED: Final = frozenset({list, dict, set})  # of what is in them when transitions are evaluated
_LONG: Final = 1000  # a longer one is shown as it is now


class Evaluated(NamedTuple):
    """The value of a transition, and for how long the machine was in its state then."""

    value: bool | None
    """None if it has raised."""
    elapsed_ns: int


class LastTurn(NamedTuple):
    """A turn of a machine in which it has evaluated transitions of a state."""

    state: str
    entered_ns: int
    time_ns: int
    """When it evaluated the first of them."""
    attributes: Mapping[str, Any]
    """The sensors and variables that they saw."""
    transitions: dict[int, Evaluated]
    """By their numbers, as far as they were evaluated."""

    @property
    def has_fired(self) -> bool:
        """Whether one of them has fired."""
        return any(each.value for each in self.transitions.values())


class LastTurns:
    """The last turn of each machine: all of those whose events it is given, or a sample."""

    def __init__(self, arrangement: Arrangement):
        self._arrangement = arrangement
        self._turns: dict[str, LastTurn] = {}
        self._coming = ""  # the machine whose turn is to come
        self._sampled: list[_Sampled] = []

    def __call__(self, event: Event) -> None:
        """Take an event."""
        if isinstance(event, Turn):
            self._coming = event.machine  # a debugger may wait now
        elif isinstance(event, Eval | Section):
            if event.machine == self._coming:
                self._coming = ""
                self._turns.pop(event.machine, None)
            if isinstance(event, Eval):
                seat = self._arrangement.seat(event.machine)
                self._take(seat, event.state, event.transition, event.value, event.time_ns)

    def sample(self) -> None:
        """Keep the next turn of each machine in its state: to keep all would slow them down."""
        for each in self._sampled:
            each.end()
        seats = [self._arrangement.seat(each.name) for each in self._arrangement.machines]
        self._sampled = [_Sampled(self, seat) for seat in seats if seat.current.transitions]

    def take_failure(self, seat: Seat, state: str, number: int, now_ns: int) -> None:
        """Take that a transition has raised: those before it did not hold."""
        self._turns.pop(seat.name, None)
        for each in range(number):
            self._take(seat, state, each, False, now_ns)
        self._take(seat, state, number, None, now_ns)

    def forget(self, machine: str = "") -> None:
        """Forget the turn of a machine, or of all: there will be others that are not seen."""
        if machine:
            self._turns.pop(machine, None)
        else:
            self._turns.clear()

    def of(self, machine: str) -> LastTurn | None:
        """Return the last turn of a machine; None if it is not known."""
        return self._turns.get(machine)

    def _take(self, seat: Seat, state: str, number: int, value: bool | None, now_ns: int) -> None:
        turn = self._turns.get(seat.name)
        if turn is None:
            seen = vars(seat.machine).items()
            attributes = {name: _kept(value) for name, value in seen}
            turn = LastTurn(state, seat.entered_ns, now_ns, attributes, {})
            self._turns[seat.name] = turn
        turn.transitions[number] = Evaluated(value, now_ns - turn.entered_ns)


class _Sampled:
    """The state of a machine whose transitions are seen when they are evaluated next."""

    def __init__(self, turns: LastTurns, seat: Seat):
        self._turns = turns
        self._seat = seat
        self._state: BoundState = seat.current
        self._before = seat.current.transitions
        self._wrapped = tuple(map(self._watching, range(len(self._before))))
        self._state.transitions = self._wrapped

    def end(self) -> None:
        """Let them be as they were, unless they were bound anew."""
        if self._state.transitions is self._wrapped:
            self._state.transitions = self._before

    def _watching(self, number: int) -> BoundTransition:
        limit_ns, guard, target = self._before[number]
        seat, environment = self._seat, self._seat.arrangement.environment
        now, is_last = environment.clock.now_ns, number == len(self._before) - 1

        def evaluate_and_take(machine: Any) -> bool:
            due = limit_ns is None or now() - seat.entered_ns > limit_ns
            value = due and (guard is None or guard(machine))
            if isinstance(value, bool):  # else the ringlet looks for this function
                if not number:
                    self._turns.forget(seat.name)
                self._turns._take(seat, self._state.name, number, value, environment.peek_ns())
                if value or is_last:
                    self.end()
            return value

        return None, evaluate_and_take, target


def _kept(value: Any) -> Any:
    return value.copy() if type(value) in _COPIED and len(value) <= _LONG else value
