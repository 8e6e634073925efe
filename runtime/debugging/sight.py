"""What is known of a machine's transitions at a moment: those of its state, and those before."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from .causes import Cause, fired, seen_in, why

if TYPE_CHECKING:
    from llfsm.runtime.engine.arrangement import Arrangement
    from llfsm.runtime.engine.errors import ExecutionError
    from llfsm.runtime.engine.seat import Seat

    from .last_turns import LastTurns

__all__ = ["Fired", "Sight", "raised_at", "sight_of"]


def raised_at(seat: Seat, error: ExecutionError) -> int:
    """Return the number of the transition that has raised.

    It is -1 if code before the transitions has, and their number if that after them has.
    """
    state = seat.states.get(error.state)  # one that is not declared has no transitions
    transitions = [] if state is None else seat.declared(state).transitions
    steps = [f"transition {each.label}" for each in transitions] + ["Internal"]
    return steps.index(error.step) if error.step in steps else -1


class Fired(NamedTuple):
    """A transition that has fired, and what the transitions of its state had seen."""

    machine: str
    source: str
    target: str
    """"" if none has fired: code of the machine has raised in the state `source`."""
    causes: list[Cause]
    error: ExecutionError | None = None
    """What that code has raised."""

    @classmethod
    def of(cls, seat: Seat, source: str, now_ns: int) -> Fired:
        """Return the one by which a machine is just leaving a state."""
        elapsed_ns, number = now_ns - seat.entered_ns, seat.arrival().transition
        causes = fired(seat.machine, source, number, elapsed_ns)
        return cls(seat.name, source, seat.current.name, causes)

    @classmethod
    def failed(cls, seat: Seat, error: ExecutionError, now_ns: int) -> Fired:
        """Return what the transitions of a state had seen in which code has raised."""
        number = raised_at(seat, error)
        elapsed_ns = now_ns - seat.entered_ns
        causes = fired(seat.machine, error.state, number, elapsed_ns, value=None)
        return cls(seat.name, error.state, "", causes, error)


class Sight(NamedTuple):
    """What is known of the transitions of a machine in `state`."""

    state: str
    causes: list[Cause]
    evaluated_ns: int | None
    """When they were evaluated last; None if they are as they would be now."""
    before: Fired | None
    """How it came to the state, if it was not evaluated there yet."""


def sight_of(arrangement: Arrangement, machine: str, turns: LastTurns, now_ns: int) -> Sight:
    """Return what is known of a machine at `now_ns`, from its last turn if that is known."""
    state, arrival = arrangement.standing(machine).state, arrangement.arrival(machine)
    turn, found = turns.of(machine), arrangement.machine(machine)
    if turn is not None and (turn.state, turn.entered_ns) == (state, arrival.entered_ns):
        return Sight(state, seen_in(turn, found), turn.time_ns, None)
    elapsed_ns = None if arrival.entered_ns is None else now_ns - arrival.entered_ns
    before = None
    if turn is not None and turn.has_fired:
        before = Fired(machine, turn.state, state, seen_in(turn, found))
    return Sight(state, why(found, state, elapsed_ns), None, before)
