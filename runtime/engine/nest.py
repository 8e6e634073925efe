"""The machines inside one machine: those that its states run, and those that it has called.

Both end with the state in which they began, inwards first: their own inner machines, then they
themselves with their safe values, then the state's OnExit. What a state *runs* differs in three
ways from what its code calls. It has its turns right behind the outer machine's, so that a round is
one sequence, depth first. A suspension of the outer machine suspends it where it is, and a
resumption goes on there. And a failure of it for which no transition of the state fires is a
failure of the outer machine.

The code of bound states is wrapped for that, so a turn of a machine without inner ones costs
nothing.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any, Generic, NamedTuple, Protocol, TypeVar

from llfsm.runtime.engine.errors import ExecutionError
from llfsm.runtime.engine.events import Request, Status
from llfsm.runtime.engine.ringlet import BoundState
from llfsm.runtime.engine.state import State
from llfsm.runtime.engine.submachine import InnerSeat, Submachine, Submachines


class Nested(InnerSeat, Protocol):
    """A seat, as the nest of its outer machine's and its own know it."""

    name: str
    machine: Any
    accepted: bool
    taken: bool
    left: bool
    request: Request | None
    current: BoundState
    states: dict[str, BoundState]
    suspension: BoundState
    children: list[Any] | None
    """The seats that its current state runs, in order of turns; None for each that has ended."""
    parking: bool
    """True if it is out of the arrangement, and may be returned to it."""

    @property
    def suspended(self) -> bool:
        """True if the machine is in its suspend state."""

    def schedule(self, request: Request) -> Status:
        """Replace the request."""

    def begin(self, state: State, number: int) -> Any:
        """Load what a state runs into a seat of its own, and return that."""

    def halt(self) -> None:
        """Suspend the machine now: OnSuspend runs, and the next turn is in the suspend state."""

    def park(self, *, wakes: bool) -> None:
        """Suspend the machine now and take it out of the arrangement, to be returned to it.

        Its next turn there resumes it if it `wakes`; else it was suspended alone, and stays so.
        """

    def unpark(self) -> None:
        """Return a machine that was parked."""


S = TypeVar("S", bound=Nested)


class RunStanding(NamedTuple):
    """The standing of a run: its state, whether that was left, and names of machines."""

    state: str
    over: bool
    seats: tuple[str, ...]
    halted: tuple[str, ...]
    parked: tuple[str, ...]
    restarting: tuple[str, ...] = ()


class Run(Generic[S]):
    """The machines that a state runs, from its OnEntry on."""

    def __init__(self, state: State):
        self.seats: list[S] = []
        self.over = False
        """True if the state was left."""
        self.history = state.history
        self._several = state.several
        self.halted: list[S] = []
        """Those that the outer machine's suspension has suspended."""
        self.parked: list[S] = []
        """Those that are to go on when the state is entered again."""
        self.restarting: list[S] = []
        """Those whose restart was asked for while the outer machine was suspended."""

    @property
    def view(self) -> Submachine[Any] | Submachines:
        """The machines, as code of the outer one sees them."""
        each = tuple(map(Submachine[Any], self.seats))
        return Submachines(each) if self._several else each[0] if each else Submachine(None)

    def standing(self, state: str) -> RunStanding:
        """Return its standing, by names."""
        seats, halted, parked, restarting = (
            tuple([seat.name for seat in each]) for each in self._lists
        )
        return RunStanding(state, self.over, seats, halted, parked, restarting)

    @property
    def _lists(self) -> tuple[list[S], ...]:
        return self.seats, self.halted, self.parked, self.restarting

    def note_restart(self, seat: S, request: Request | None) -> None:
        """Note that a machine is to begin anew when it goes on, or that it is not; None: as is."""
        if request is Request.SUSPEND and seat in self.restarting:  # a resume undoes no restart
            self.restarting.remove(seat)
        elif request is Request.RESTART and seat not in self.restarting:
            self.restarting.append(seat)

    def wake(self, seats: list[S]) -> None:
        """Resume or restart machines, as the outer one goes on."""
        for seat in seats:
            if seat.taken and seat.suspended:
                restarts = seat in self.restarting
                seat.schedule(Request.RESTART if restarts else Request.RESUME)
        self.restarting.clear()
        seats.clear()

    @property
    def done(self) -> bool:
        """True if all have accepted."""
        return all(seat.accepted for seat in self.seats)


class Nest(Generic[S]):
    """The inner machines of the machine in `outer`, by the state with which they end."""

    def __init__(self, outer: S):
        self._outer = outer
        self._called: dict[BoundState, list[S]] = {}
        self._runs: dict[BoundState, Run[S]] = {}

    def work(self, state: State, bound: BoundState) -> Submachine[Any] | Submachines:
        """Return the machines that a state runs, or has run last."""
        return (self._runs.get(bound) or Run[S](state)).view

    @property
    def standing(self) -> tuple[RunStanding, ...]:
        """The standings of its runs, by names."""
        return tuple([run.standing(bound.name) for bound, run in self._runs.items()])

    def restore(
        self, standing: tuple[RunStanding, ...], states: Mapping[str, State], seats: Mapping[str, S]
    ) -> None:
        """Let its runs stand as they did, by all states of the machine and all seats by name."""
        self._runs.clear()
        for name, over, *lists in standing:
            run = self._runs[self._outer.states[name]] = Run(states[name])
            run.over = over
            run.seats, run.halted, run.parked, run.restarting = (
                [seats[inner] for inner in names] for names in lists
            )

    def seats(self, bound: BoundState) -> list[S]:
        """List the seats of what a state runs, or has run last."""
        return self._runs[bound].seats if bound in self._runs else []

    def runs(self, bound: BoundState) -> bool:
        """Check that a state runs anything, and was entered."""
        return bound in self._runs

    @property
    def waits(self) -> bool:
        """True if what the current state runs is not done."""
        run = self._runs.get(self._outer.current)
        return run is not None and not run.over and not run.done

    @property
    def calling(self) -> Collection[BoundState]:
        """The states in which machines were called."""
        return self._called.keys()

    def holds(self, seat: S, request: Request) -> bool:
        """Check that a request to an inner machine waits for the end of the outer one's suspension.

        What is asked for last decides whether it is suspended after that.
        """
        outer = self._outer
        for bound, run in self._runs.items() if outer.suspended else ():
            if seat in run.seats and not run.over and bound is not outer.suspension:
                if seat in run.halted:
                    run.halted.remove(seat)
                if request is not Request.SUSPEND:
                    run.halted.append(seat)
                run.note_restart(seat, request)
                return request is not Request.SUSPEND
        return False

    def call(self, bound: BoundState, called: S) -> None:
        """Let a machine that was called end with a state."""
        self._called.setdefault(bound, []).append(called)

    def enter(self, state: State, bound: BoundState) -> None:
        """Run what a state runs; go on with it after a suspension, or if it has a history."""
        outer, run = self._outer, self._runs.get(bound)
        if run is not None and not run.over:
            run.wake(run.halted)
            return
        turns = [each for each in outer.children or () if each is not None]
        outer.children = turns
        if run is not None and run.parked:
            run.over = False
            for seat in run.parked:
                seat.unpark()
                if seat in run.restarting:
                    seat.schedule(Request.RESTART)
            run.restarting.clear()
            turns += run.parked
            run.parked.clear()
            return
        run = self._runs[bound] = Run(state)
        for number in range(len(state.runs)):  # each one must end if the next cannot be loaded
            run.seats.append(outer.begin(state, number))
            turns.append(run.seats[-1])

    def check(self, bound: BoundState) -> None:
        """Raise what a machine that the state runs has raised, as no transition has fired."""
        for seat in self._runs[bound].seats:
            view = Submachine[Any](seat)
            if view.failed:
                what = "was unloaded before it was done" if view.error is None else "has failed"
                error = ExecutionError(
                    f"{seat.name} {what}, and no transition is for that",
                    *(self._outer.name, bound.name, "runs", None, None),
                )
                if isinstance(view.error, BaseException):  # else nobody knows it
                    error.__cause__ = view.error
                raise error

    def halt(self, bound: BoundState) -> None:
        """Suspend what a state runs where it is: the last one first."""
        self._end_calls(bound)
        run = self._runs.get(bound)
        if run is not None and not run.over:
            for seat in reversed(run.seats):
                if seat.taken and not seat.suspended:
                    if seat.request is not Request.SUSPEND:  # which would be one of its own
                        run.halted.append(seat)
                    run.note_restart(seat, seat.request)
                    seat.halt()

    def leave(self, bound: BoundState, *, keep: bool) -> None:
        """End the inner machines of a state, the latest first; `keep` those that may go on later.

        That is if the state has a history, and none of them has failed.
        """
        self._end_calls(bound)
        run = self._runs.get(bound)
        if run is None or run.over:
            return
        run.over = True
        halted, run.halted = run.halted, []
        keep = keep and run.history and not any(seat.failure for seat in run.seats)
        if not keep:
            run.restarting.clear()
        for seat in reversed(run.seats):
            if seat.taken:
                seat.left = True
                if keep:
                    run.parked.insert(0, seat)
                    asked = seat.request  # what is asked for last decides
                    run.note_restart(seat, asked)
                    wakes = not seat.suspended or seat in halted
                    seat.park(wakes=wakes if asked is None else asked is not Request.SUSPEND)
                else:
                    seat.leave()

    def leave_all(self, *, keep: bool = False) -> None:
        """Leave all states; unless `keep`, nothing goes on later."""
        for bound in reversed([*self._runs]):
            self.leave(bound, keep=keep)
        for bound in [*self._called]:
            self._end_calls(bound)
        if not keep:
            for run in self._runs.values():
                run.restarting.clear()
                while run.parked:
                    run.parked.pop().parking = False

    def _end_calls(self, bound: BoundState) -> None:
        while called := self._called.get(bound):
            called.pop().leave()
