"""The ringlet, which is one turn of one machine, and the rotation, which gives turns one by one.

The numbers in `ringlet` are those of the execution semantics; everything that runs machines comes
through it, so traces are the same whoever gives the turns. Three choices make it fast, and readable
on one screen:

* A seat holds *bound* states: plain functions and targets. Nothing is looked up by name, and what
  observers want is wrapped around these functions, so the ringlet knows nothing of observers.
* It keeps no record of its steps. If code raises, `Seat.explain` finds where by looking for the
  function; a watchdog reads `state` and `code` from the frame.
* Whatever is rare is left to methods of the seat and the rotation: requests, failures, accepting.

Both are defined here in Python. Where the extension was compiled, its twins take their places at
the end of this module; the definitions stay as `defined_ringlet` and `DefinedRotation`, and random
machines run on both in the tests. The twins need the fields of seats and states in a C structure:
so these are classes of their own, `SeatFields` and `StateFields`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from contextlib import suppress
from operator import attrgetter
from typing import TYPE_CHECKING, Any, Generic, TypeAlias, TypeVar

from llfsm.runtime.engine.clock import NEVER
from llfsm.runtime.engine.errors import ExecutionError

if TYPE_CHECKING:
    from llfsm.runtime.engine.events import Request
    from llfsm.runtime.engine.state import Guard, SectionCode, Waiting
    from llfsm.runtime.engine.statistics import MeterFields, Timing

S = TypeVar("S", bound="SeatFields")

BoundSensor: TypeAlias = tuple[str, Callable[[], object], object]
"""A sensor's name, what reads it, and what stands for None in the snapshot."""
BoundTransition: TypeAlias = tuple["int | None", "Guard | None", "BoundState"]
"""Nanoseconds in the state that must have passed (None: any), the guard and the target."""
Running: TypeAlias = tuple["BoundState", "Callable[[Any], object] | None", int]
"""The state in which a ringlet began, the code it runs (None: the snapshot), and its step."""


class StateFields:
    """The fields of a bound state that a turn uses."""

    on_entry: SectionCode | None
    on_exit: SectionCode | None
    internal: SectionCode | None
    on_suspend: SectionCode | None
    on_resume: SectionCode | None
    transitions: tuple[BoundTransition, ...]
    spent_ns: int


class SeatFields:
    """The fields of a seat that a turn uses."""

    machine: Any
    request: Request | None
    sensors: tuple[BoundSensor, ...]
    current: BoundState
    previous: BoundState | None
    source: BoundState | None
    suspension: BoundState
    notifies: bool
    now: Callable[[], int]
    entered_ns: int
    meter: MeterFields | None
    timed: BoundState | None
    failure: object
    hang: str
    inner: bool
    children: list[Any] | None

    if TYPE_CHECKING:  # what else of a seat turns need; the twin calls these methods, too
        name: str
        states: dict[str, BoundState]

        def perform_request(self) -> None:
            """Apply and clear the request."""

        def explain(self, state: BoundState, code: object, error: BaseException) -> BaseException:
            """Make the error to raise for one that `code` raised, in a ringlet of `state`."""

        def not_a_bool(self, state: BoundState, guard: object, value: object) -> ExecutionError:
            """Make the error to raise for a `value`, neither True nor False, of `guard`."""


def ringlet(seat: SeatFields, /) -> bool:
    """Run one turn of the machine in `seat`; return True if a transition fired.

    1. Apply the pending request. 2. Take the snapshot. 3. Notify the states of suspension.
    4. Enter. 5. Evaluate the transitions in order; the first true one fires. 6. If none
    does, run Internal. An exception becomes an `ExecutionError`: `code` is always what is running.
    """
    if seat.request is not None:  # 1
        seat.perform_request()
    machine, state = seat.machine, seat.current
    code: Callable[[Any], object] | None = None
    try:
        for name, read, default in seat.sensors:  # 2
            value = read()
            setattr(machine, name, default if value is None else value)
        previous = seat.previous
        if state is not previous:
            seat.previous, seat.source = state, previous
            if not seat.notifies:  # 3
                pass
            elif state is seat.suspension:
                if previous is not None and (code := previous.on_suspend) is not None:
                    code(machine)
            elif previous is seat.suspension:
                if (code := previous.on_resume) is not None:
                    code(machine)
                if (code := state.on_resume) is not None:
                    code(machine)
            now = seat.now  # 4; a plain call: seat.now() would look for a method first
            seat.entered_ns = now()
            if (code := state.on_entry) is not None:
                code(machine)
        for limit_ns, code, target in state.transitions:  # 5
            if limit_ns is not None:
                now = seat.now
                if now() - seat.entered_ns <= limit_ns:
                    continue
            if code is not None:
                value = code(machine)
                if value is False:
                    continue
                if value is not True:
                    raise seat.not_a_bool(state, code, value)
            seat.current = target
            if (code := state.on_exit) is not None:
                code(machine)
            return True
        if (code := state.internal) is not None:  # 6
            code(machine)
        return False
    except BaseException as error:
        raise seat.explain(state, code, error)  # noqa: B904  # which knows the cause


def running(seat: SeatFields, /) -> Running | None:
    """Return None: of the definition, the ringlet's frame shows what runs."""
    return None


class Rotation(Generic[S]):
    """Give seats their turns. A subclass decides what comes of them, and sets the attributes."""

    _turn: Callable[[S], bool]
    """A ringlet; another one when an observer comes or goes, also during a round."""
    _leaving: list[S]
    """To be unloaded when their ringlet is over."""
    stopwatch: Timing | None
    """Times the turns, if they are timed."""
    _gate: Callable[[], bool] | None
    """A round begins when this returns True: at its time, or at once; after the end it raises."""
    nests: bool
    """True once a state has run a machine: before that, no turn looks for one."""
    rounds: int
    """The number of rounds so far."""

    def give_turns(self, seats: Iterable[S | None], /, *, inner: bool = False) -> bool:
        """Give each seat its turn; return True if a transition fired in any.

        Behind each, depth first, come the seats of what its state runs, which are `inner` ones.
        """
        any_fired = False
        for seat in seats:
            if seat is None or seat.inner is not inner:
                continue
            turn, stopwatch, fired = self._turn, self.stopwatch, False
            try:
                try:
                    fired = turn(seat)
                finally:
                    if stopwatch is not None:
                        stopwatch.take(seat, fired)
                if fired:
                    any_fired = True
                elif not seat.current.transitions:
                    self._accept(seat)
            except ExecutionError as error:
                self.fail(seat, error)
            if self._leaving:
                self._let_go()
            if seat.children and self.give_turns(seat.children, inner=True):
                any_fired = True
        return any_fired

    def give_round(self, seats: Iterable[S | None], /) -> bool:
        """Give a round that nobody observes, and for whose time nobody waits."""
        self.rounds += 1
        return self.give_turns(seats)

    def give_rounds(self, seats: list[S | None], sleep: Callable[[], bool], /) -> bool:
        """Give rounds, and sleep after each, until one changes where a machine stands.

        Or until `sleep` returns False, or an observer comes: `_turn` is what it was when it began.
        Return True if a transition fired in the last round. A round that changes nothing is what a
        machine that waits has most of: so here it costs its turns, and little else.
        """
        turn, before = self._turn, [marks_of(seat) for seat in seats]
        while self._gate is None or self._gate():
            fired = self.give_round(seats)
            is_same = self._turn is turn and [marks_of(seat) for seat in seats] == before
            if fired or not is_same or not sleep():
                return fired
        return False

    # A subclass's part. The twin in C calls the same names.

    def _accept(self, seat: S) -> None:
        raise NotImplementedError

    def fail(self, seat: S, error: ExecutionError) -> None:
        """Do what is to be done about a machine whose code raised, within its turn."""
        raise NotImplementedError

    def _let_go(self) -> None:
        raise NotImplementedError


_changing = attrgetter("current", "previous", "request", "entered_ns", "failure", "hang")


def marks_of(seat: SeatFields | None) -> tuple[object, ...]:
    """Collect the objects of which another one is there if the machine's standing has changed."""
    return () if seat is None else (seat, *_changing(seat))


defined_ringlet = ringlet
DefinedRotation = Rotation
if not TYPE_CHECKING:  # the definitions have the types
    with suppress(ImportError):
        from llfsm.runtime.engine._ringlet import (
            Rotation,
            SeatFields,
            StateFields,
            ringlet,
            running,  # noqa: F401  # takes the place of the one above
        )


class BoundState(StateFields):
    """A state of one loaded machine: plain functions and targets, nothing to look up.

    It stays the same object while observers come and go; only what it holds is exchanged.
    """

    __slots__ = ("name", "waiting")

    def __init__(self, name: str):
        self.name = name
        self.waiting: Waiting | None = None  # what its machine waits for in it, once found out
        self.on_entry: SectionCode | None = None
        self.on_exit: SectionCode | None = None
        self.internal: SectionCode | None = None
        self.on_suspend: SectionCode | None = None
        self.on_resume: SectionCode | None = None
        self.transitions: tuple[BoundTransition, ...] = ()
        self.spent_ns = NEVER  # how long the machine was in it, if its turns are timed
