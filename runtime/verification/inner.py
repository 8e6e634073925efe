"""Machines that states run, in an exploration: each that a state may run has a place of its own.

In a run such a machine is made when its state is entered. Here it is there from the start, but not
loaded; to enter the state gives it the variables of one that is made then. If a state is found to
run a class that its declaration does not name, or a machine inside of itself, the exploration
begins again with a place for that, too (`UnknownInnerError`).

When a machine ends it is forgotten, so that what it was makes no two states of one: its control
state and variables are what they were at the start. Only its variables are kept, if code is found
to look at them later.

Whatever the outer machine's ringlet learns of an inner one, or changes, is noted in the environment
by name: its control state (`ask`) and its variables (`look_at`).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Any, TypeAlias

from llfsm.runtime.engine.clock import NEVER
from llfsm.runtime.engine.kernel import Loader
from llfsm.runtime.engine.machine import Machine
from llfsm.runtime.engine.nest import Nest
from llfsm.runtime.engine.seat import Seat, require_shallow
from llfsm.runtime.engine.submachine import Raised, Submachine, Submachines
from llfsm.runtime.engine.table import REQUIRED, run_by
from llfsm.runtime.expressions.reads import may_use
from llfsm.runtime.verification.errors import UnsupportedError

if TYPE_CHECKING:
    from llfsm.runtime.engine.events import Request
    from llfsm.runtime.engine.kernel import Control
    from llfsm.runtime.engine.ringlet import BoundState
    from llfsm.runtime.engine.state import State
    from llfsm.runtime.verification.environment import ExploredEnvironment


Made: TypeAlias = dict[tuple[str, str, int], list[type[Machine]]]
"""By an outer machine, a state, and the number of what that runs: classes that were made there."""


class UnknownInnerError(UnsupportedError):
    """A state runs a class for which there is no place."""

    def __init__(self, outer: str, state: str, number: int, cls: type[Machine]):
        super().__init__(f"{outer} runs a {cls.__qualname__} in {state}, which nothing names")
        self.place = outer, state, number
        self.cls = cls


class InnerLoader(Loader):
    """Load machines, and those that their states run into the places that they have.

    There are places for the classes that states name, and for those in `made`.
    """

    def __init__(self, control: Control, environment: ExploredEnvironment, made: Made):
        super().__init__(control, None)
        self.classes |= control.loader.classes
        self._made = made
        self.is_open = False
        """True if a state may run what has no place yet, as far as its declaration shows."""
        self._control = control
        self._environment = environment
        self._places: dict[tuple[str, str, int, type[Machine]], Seat] = {}
        self.ports: dict[str, dict[str, Any]] = {}
        """Of each machine, what its attributes are that are no variables."""

    def with_inner(self, seats: Iterable[Seat]) -> tuple[Seat, ...]:
        """List seats, each followed by a new one for each machine that its states may run."""
        found = tuple([each for seat in [*seats] for each in self._depth_first(seat)])
        for seat in self._places.values():  # once all have an index of their own
            self._control.roster.remove(seat)
            seat.taken = False
        return found

    def _depth_first(self, outer: Seat) -> Iterator[Seat]:
        yield outer
        if not any(state.runs for state in outer.table.states):
            return
        for state in outer.table.states:
            for number in range(len(state.runs)):
                for seat in self._seats_of(outer, state, number):
                    yield from self._depth_first(seat)
        outer.nest = ExploredNest(outer, self._environment)
        outer.kernel.bind(outer)

    def _seats_of(self, outer: Seat, state: State, number: int) -> Iterator[Seat]:
        runs = state.runs[number]
        if isinstance(runs, str) and runs not in self.classes:
            raise UnsupportedError(
                f"{outer.name}.{state.name} runs {runs!r}, which is none of the machines here: "
                f"this cannot be explored; give the class, or a function that names it"
            )
        named, classes = run_by(runs), _classes(outer, state, number, self._made)
        self.is_open |= not named or not {*classes} >= {*named}
        for cls in classes:
            seat = _seat(outer, state, number, cls)
            name = seat.name
            self._places[outer.name, state.name, number, cls] = super().put(seat)
            if seat.name != name:
                raise UnsupportedError(
                    f"{name} is the name of what two states run, one of which does not name it: "
                    f"this cannot be explored; give the class, or a function that names it, in both"
                )
            yield seat

    def seat_within(self, outer: Seat, state: State, number: int, made: Any) -> Seat:
        """Give the place of what a state runs to the machine that was made."""
        machine = self._make(made, None)
        require_shallow(outer.name, sum(1 for _ in _outwards(outer)) - 1)
        seat = self._places.get((outer.name, state.name, number, type(machine)))
        if seat is None:
            self._environment.refusal = UnknownInnerError(
                outer.name, state.name, number, type(machine)
            )
            raise self._environment.refusal
        for place, each in self._places.items():
            if place[:3] == (outer.name, state.name, number):  # nobody knows of those of before
                self._environment.ask(each.name)
                self._begin_anew(each)
        vars(seat.machine).update(vars(machine))
        return seat

    def put(self, seat: Seat) -> Seat:
        """Let a machine be there that has a place."""
        if not self.ports:  # at the start
            return super().put(seat)
        vars(seat.machine).update(self.ports[seat.name])
        if not seat.taken:
            seat.taken = True
            self._control.roster.add(seat)
        return seat

    def is_forgotten(self, seat: Seat) -> bool:
        """Check that a machine is an inner one that has ended for good."""
        return seat.caller is not None and not (seat.taken or seat.parking)

    def forget(self, seat: Seat, *, kept: bool = False) -> None:
        """Let a machine that has ended stand at its begin, but for how it has ended.

        What is `kept` are its variables, and what its own states have run.
        """
        seat.current = seat.remembered = seat.initial
        seat.previous = seat.request = seat.stood = None
        seat.entered_ns = NEVER
        if kept:
            return
        self._environment.make(seat.name)
        vars(seat.machine).clear()
        vars(seat.machine).update(self.ports[seat.name] | vars(blank(type(seat.machine))))
        if any(state.runs for state in seat.table.states):
            seat.nest.restore((), {}, {})
            for inner in self._places.values():
                if inner.caller is seat:
                    self._environment.ask(inner.name)
                    self._begin_anew(inner)

    def _begin_anew(self, seat: Seat) -> None:
        self.forget(seat)
        seat.accepted = seat.left = seat.parking = False
        seat.failure = None


class ExploredNest(Nest[Seat]):
    """Note each inner machine on which a ringlet of the outer one depends, or that it changes."""

    def __init__(self, outer: Seat, environment: ExploredEnvironment):
        super().__init__(outer)
        self._seat = outer
        self._environment = environment

    def _note(self, bound: BoundState) -> None:
        for seat in self.seats(bound):
            self._environment.ask(seat.name)

    def work(self, state: State, bound: BoundState) -> Submachine[Any] | Submachines:
        """Return the machines that a state runs, or has run last."""
        self._note(bound)
        each = tuple(
            Submachine[Any](_Looked(seat, self._environment)) for seat in self.seats(bound)
        )
        return Submachines(each) if state.several else each[0] if each else Submachine(None)

    def holds(self, seat: Seat, request: Request) -> bool:
        """Check that a request to an inner machine waits for the outer one's suspension's end."""
        self._environment.ask(self._seat.name)
        return super().holds(seat, request)

    @property
    def waits(self) -> bool:
        """True if what the current state runs is not done."""
        self._note(self._seat.current)
        return super().waits

    def enter(self, state: State, bound: BoundState) -> None:
        """Run what a state runs, or go on with it."""
        self._note(bound)
        super().enter(state, bound)

    def check(self, bound: BoundState) -> None:
        """Raise what a machine that the state runs has raised."""
        self._note(bound)
        super().check(bound)

    def halt(self, bound: BoundState) -> None:
        """Suspend what a state runs; refuse code that this would run, if it could read sensors."""
        self._note(bound)
        for seat in self.seats(bound):
            self._check_halt(seat)
        super().halt(bound)

    def leave(self, bound: BoundState, *, keep: bool) -> None:
        """End the inner machines of a state."""
        self._note(bound)
        if keep and any(run.state == bound.name and not run.over for run in self.standing):
            for seat in self.seats(bound):
                self._check_halt(seat)
        super().leave(bound, keep=keep)

    def _check_halt(self, seat: Seat) -> None:
        if not seat.taken or seat.suspended:
            return
        code = seat.declared(seat.current).sections.get("OnSuspend")
        if code is not None:
            self._environment.look_at(seat.name)
            if may_use(code, type(seat.machine), seat.table.sensors):
                self._environment.refuse(
                    f"suspends {seat.name} in {seat.current.name}, whose OnSuspend could read "
                    f"sensors: this cannot be explored; use OnEntry of its suspend state"
                )


class _Looked:
    """The seat of an inner machine, as the code of the outer one looks at it."""

    def __init__(self, seat: Seat, environment: ExploredEnvironment):
        self._seat = seat
        self._environment = environment
        self.name = seat.name

    @property
    def machine(self) -> Any:
        """The machine, whose variables are noted."""
        forgotten = not (self._seat.taken or self._seat.parking)
        self._environment.look_at(self.name, ended=forgotten)
        return self._seat.machine

    @property
    def accepted(self) -> bool:
        """True if it has accepted."""
        return self._seat.accepted

    @property
    def taken(self) -> bool:
        """True if it is loaded."""
        return self._seat.taken

    @property
    def left(self) -> bool:
        """True if its state was left before it was done."""
        return self._seat.left

    @property
    def failure(self) -> Raised | None:
        """The error that its code has raised."""
        return self._seat.failure

    def leave(self) -> None:
        """Unload the machine if it is loaded."""
        self._seat.leave()


def inner_seats(outer: Seat, made: Made) -> Iterator[Seat]:
    """Make a seat for each machine that states of one may run, as one that is not loaded."""
    for state in outer.table.states:
        for number in range(len(state.runs)):
            for cls in _classes(outer, state, number, made):
                inner = _seat(outer, state, number, cls)
                yield inner
                yield from inner_seats(inner, made)


def _classes(outer: Seat, state: State, number: int, made: Made) -> list[type[Machine]]:
    """List the classes that a state may run: those it names, but outer ones, and those made."""
    around = {type(each.machine) for each in _outwards(outer)}
    named = [cls for cls in run_by(state.runs[number]) if cls not in around]
    return [*dict.fromkeys([*named, *made.get((outer.name, state.name, number), [])])]


def _seat(outer: Seat, state: State, number: int, cls: type[Machine]) -> Seat:
    name = f"{outer.name}/{outer.table.inner_name(state, number, cls.__name__)}"
    path = f"{outer.path}/{cls.table.path}"
    seat = Seat(blank(cls), outer.control, name, path, outer.renamed, {})
    seat.called, seat.caller = True, outer
    return seat


def _outwards(seat: Seat | None) -> Iterator[Seat]:
    while seat is not None:
        yield seat
        seat = seat.caller


def blank(cls: type[Machine]) -> Machine:
    """Make a machine at whose variables nobody looks: they have no value, or the default."""
    machine: Machine = cls.__new__(cls)
    for name, variable in cls.table.variables.items():
        setattr(machine, name, None if variable.default is REQUIRED else variable.initial())
    return machine
