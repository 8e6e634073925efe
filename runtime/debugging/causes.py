"""The reasons for which a machine is in its state: its transitions, and the values in them.

Three things are known of transitions. As they were evaluated last: an observer (`LastTurns`) keeps
each machine's last turn, with the sensors and variables that it saw, while a debugger is attached,
and a sample of turns otherwise, as keeping all would slow the machines down. As they had fired or
failed (`Fired`), when a breakpoint is hit. And as they would be evaluated now (`why`), of what was
not seen. A `Sight` is what is known at one moment.
"""

from __future__ import annotations

import ast
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import is_dataclass
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from llfsm.runtime.engine.events import Eval, Event, Section, Turn
from llfsm.runtime.engine.source_text import EXPRESSION
from llfsm.runtime.expressions.annotated import annotated, elapsed_text
from llfsm.runtime.expressions.evaluation import Evaluator, parsed

if TYPE_CHECKING:
    from llfsm.runtime.engine.arrangement import Arrangement
    from llfsm.runtime.engine.errors import ExecutionError
    from llfsm.runtime.engine.machine import Machine
    from llfsm.runtime.engine.ringlet import BoundState, BoundTransition
    from llfsm.runtime.engine.seat import Seat
    from llfsm.runtime.engine.state import Transition


_LONG: Final = 1000  # values that are copied of a machine; more are shown as they are now


_CONTAINERS: Final = frozenset({list, dict, set})


class Evaluated(NamedTuple):
    """The value of a transition, and for how long the machine was in its state then."""

    value: bool | None
    """None if it has raised."""
    elapsed_ns: int
    attributes: Mapping[str, Any]
    """The sensors and variables that it saw."""


class LastTurn(NamedTuple):
    """A turn of a machine in which it has evaluated transitions of a state."""

    state: str
    entered_ns: int
    time_ns: int
    """When it evaluated the first of them."""
    transitions: dict[int, Evaluated]
    """By their numbers, as far as they were evaluated."""

    @property
    def has_fired(self) -> bool:
        """True if one of them has fired."""
        return any(each.value for each in self.transitions.values())


class LastTurns:
    """The last turn of each machine: all of those whose events it is given, or a sample."""

    def __init__(self, arrangement: Arrangement):
        self._arrangement = arrangement
        self._turns: dict[str, LastTurn] = {}
        self._coming = ""  # the machine whose turn is to come
        self._sampled: list[_Sampled] = []

    def __call__(self, event: Event) -> None:
        """Note what an event says of a machine's turn."""
        if isinstance(event, Turn):
            self._coming = event.machine  # a debugger may wait now
        elif isinstance(event, Eval | Section):
            if event.machine == self._coming:
                self._coming = ""
                self._turns.pop(event.machine, None)
            if isinstance(event, Eval):
                seat = self._arrangement.roster.find(event.machine)
                now_ns = seat.kernel.environment.seen_at(event.time_ns)
                self._take(seat, event.state, event.transition, event.value, now_ns)

    def sample(self) -> None:
        """Keep the next turn of each machine in its state: to keep all would slow them down."""
        for each in self._sampled:
            each.end()
        seats = [*self._arrangement.roster]
        self._sampled = [_Sampled(self, seat) for seat in seats if seat.current.transitions]

    def take_failure(self, seat: Seat, state: str, number: int, now_ns: int) -> None:
        """Note that a transition has raised: those before it did not hold."""
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
        """Give the last turn of a machine; None if it is not known."""
        return self._turns.get(machine)

    def _take(self, seat: Seat, state: str, number: int, value: bool | None, now_ns: int) -> None:
        turn = self._turns.get(seat.name)
        if turn is None:
            turn = LastTurn(state, seat.entered_ns, now_ns, {})
            self._turns[seat.name] = turn
        attributes = _Copy().of(vars(seat.machine))
        turn.transitions[number] = Evaluated(value, now_ns - turn.entered_ns, attributes)


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
        seat, environment = self._seat, self._seat.kernel.environment
        now, is_last = environment.machine_now, number == len(self._before) - 1

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


class _Copy:
    """Copy values in depth, as later code changes them, without running code of their classes."""

    def __init__(self) -> None:
        self._left = _LONG
        self._copies: dict[int, Any] = {}  # by the identity of what is copied

    def of(self, value: Any) -> Any:
        """Copy a container or a dataclass; give others as they are."""
        if id(value) in self._copies:
            return self._copies[id(value)]
        kind = type(value)
        if kind in _CONTAINERS or isinstance(value, tuple):
            self._left -= len(value)
        elif not is_dataclass(kind) or not kind.__dictoffset__:
            return value
        self._left -= 1
        return value if self._left < 0 else self._copied(value, kind)

    def _copied(self, value: Any, kind: type) -> Any:
        if isinstance(value, tuple):  # of any class: none of its code runs
            return tuple.__new__(kind, map(self.of, value))
        is_container = kind in _CONTAINERS
        try:
            copied = value.copy() if is_container else object.__new__(kind)
        except TypeError:  # a dataclass that is a container, too
            return value
        self._copies[id(value)] = copied  # what is in it may lead back to it
        if isinstance(copied, dict) or not is_container:
            parts = value if is_container else vars(value)
            found = {name: self.of(each) for name, each in parts.items()}
            (copied if is_container else vars(copied)).update(found)
        elif isinstance(copied, list):
            copied[:] = map(self.of, value)
        return copied


NOT_EVALUATED: Final = "not evaluated"
"""Stand for the operands of a transition after the one that has fired, or has raised."""


class Cause(NamedTuple):
    """A transition: its value, None if it is not known or was not evaluated."""

    target: str
    label: str
    value: bool | None
    seen: str
    """The expression with the values of its parts."""


def why(machine: Machine, state: str, elapsed_ns: int | None) -> list[Cause]:
    """Explain the transitions of a state, in their order, as they would be evaluated now.

    `elapsed_ns` is for how long the machine has been in the state; None if it has not entered it.
    Nothing is called that has an effect.
    """
    transitions = _transitions(machine, state)
    return [_cause(machine, state, each, elapsed_ns, {}) for each in transitions]


def seen_in(turn: LastTurn, machine: Machine) -> list[Cause]:
    """Explain the transitions of a state as they were evaluated in a turn.

    Of values that were not kept, such as a module's, it is shown if they give another result now.
    """
    found = []
    for number, transition in enumerate(_transitions(machine, turn.state)):
        cause, evaluated = _unseen(transition), turn.transitions.get(number)
        if evaluated is not None:
            value, elapsed_ns, attributes = evaluated
            cause = _cause(machine, turn.state, transition, elapsed_ns, attributes)
            is_stale = None not in (cause.value, value) and cause.value is not value
            seen = f"{cause.seen} (as it is now)" if is_stale else cause.seen
            cause = cause._replace(value=value, seen=seen)
        found.append(cause)
    return found


def fired(
    machine: Machine, state: str, number: int, elapsed_ns: int, *, value: bool | None = True
) -> list[Cause]:
    """Explain the transitions of a state of which that of this number has just fired.

    Those before it did not hold, and those after it were not evaluated. It has raised if its
    `value` is None; a number beyond them is none of them.
    """
    found = why(machine, state, elapsed_ns)
    values = [False] * number + [value]
    seen = [each._replace(value=held) for each, held in zip(found, values, strict=False)]
    unseen = _transitions(machine, state)[number + 1 :]
    return [*(seen if number >= 0 else ()), *map(_unseen, unseen)]


def _transitions(machine: Machine, state: str) -> list[Transition]:
    for each in type(machine).table.states:
        if each.name == state:
            return [*each.transitions]
    return []  # an undeclared suspend state


def _unseen(transition: Transition) -> Cause:
    return Cause(transition.target.name, transition.label, None, NOT_EVALUATED)


def _cause(
    machine: Machine,
    state: str,
    transition: Transition,
    elapsed_ns: int | None,
    attributes: Mapping[str, Any],
) -> Cause:
    parts: list[str] = []
    value: bool | None = True
    guard, limit_ms = transition.guard, transition.after_ms
    is_whole = guard is not None and guard.__code__.co_name == EXPRESSION  # of a bundle
    text = transition.label if is_whole else transition.expression
    if limit_ms is not None and not is_whole:
        if elapsed_ns is None:
            parts, value = [f"elapsed > {limit_ms:g} ms"], None
        else:
            parts, value = [elapsed_text(elapsed_ns, limit_ms)], elapsed_ns > limit_ms * 1e6
    if transition.ends:
        work = machine._seat.work(state)
        ends = {f"{state}.{end}": bool(getattr(work, end)) for end in transition.ends}
        parts.append(" or ".join(f"{end}={has_come}" for end, has_come in ends.items()))
        value = value and any(ends.values())
    if guard is not None:
        seen, held = f"{transition.label}: more than one expression", None
        if text is not None:
            with suppress(Exception):  # of its operators: then the guard would raise, too
                tree = parsed(text)
                evaluator = Evaluator(
                    machine, elapsed_ns, guard, state=state, attributes=attributes
                )
                seen = annotated(evaluator, text)
                if parts and isinstance(tree, ast.IfExp | ast.BoolOp):
                    seen = f"({seen})"
                found = evaluator.value(tree)
                held = found if isinstance(found, bool) else None
        parts.append(seen)
        if value is not None:
            value = value and held
    return Cause(transition.target.name, transition.label, value, " and ".join(parts) or "always")


def raised_at(seat: Seat, error: ExecutionError) -> int:
    """Find the number of the transition that has raised.

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
    """The error that this code has raised."""

    @classmethod
    def of(cls, seat: Seat, source: str, now_ns: int) -> Fired:
        """Explain how a machine is just leaving a state."""
        elapsed_ns, number = now_ns - seat.entered_ns, seat.arrival().transition
        causes = fired(seat.machine, source, number, elapsed_ns)
        return cls(seat.name, source, seat.current.name, causes)

    @classmethod
    def failed(cls, seat: Seat, error: ExecutionError, now_ns: int) -> Fired:
        """Explain the transitions of a state in which code has raised."""
        number = raised_at(seat, error)
        elapsed_ns = now_ns - seat.entered_ns
        causes = fired(seat.machine, error.state, number, elapsed_ns, value=None)
        return cls(seat.name, error.state, "", causes, error)


class Sight(NamedTuple):
    """The transitions of a machine in `state`, as far as they are known."""

    state: str
    causes: list[Cause]
    evaluated_ns: int | None
    """When they were evaluated last; None if they are as they would be now."""
    before: Fired | None
    """How it came to the state, if it was not evaluated there yet."""


def sight_of(arrangement: Arrangement, machine: str, turns: LastTurns, now_ns: int) -> Sight:
    """Explain a machine's transitions at `now_ns`, from its last turn if that is known."""
    seat = arrangement.roster.find(machine)
    state, arrival = seat.current.name, seat.arrival()
    turn, found = turns.of(machine), arrangement.machine(machine)
    if turn is not None and (turn.state, turn.entered_ns) == (state, arrival.entered_ns):
        return Sight(state, seen_in(turn, found), turn.time_ns, None)
    elapsed_ns = None if arrival.entered_ns is None else now_ns - arrival.entered_ns
    before = None
    if turn is not None and turn.has_fired:
        before = Fired(machine, turn.state, state, seen_in(turn, found))
    return Sight(state, why(found, state, elapsed_ns), None, before)
