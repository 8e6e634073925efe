"""The replaying explorer: it runs an arrangement from the start for every single turn.

What `llfsm.runtime.verification` finds of machines inside machines is compared with it. Nothing is
saved or restored, so machines are really made, suspended, put away and ended. A state is a picture
of the whole arrangement; the way to it is the list of choices that led there.
"""

from __future__ import annotations

import itertools
import pickle
from collections.abc import Callable, Collection, Iterable, Iterator
from typing import Any, NamedTuple

import pytest

from definition import Defined
from llfsm.runtime import Machine, ManualClock, Submachine, UnknownMachineError
from llfsm.runtime.engine.environment import Environment, Post, Read
from llfsm.runtime.engine.events import Request
from llfsm.runtime.engine.kernel import OnError
from llfsm.runtime.engine.ports import Actuator, Sensor
from llfsm.runtime.engine.ringlet import defined_ringlet
from llfsm.runtime.engine.seat import NEVER, Seat
from llfsm.whiteboard import Slot
from naive_explorer import START_NS, Elapsed

__all__ = ["LOOKED", "Replayed", "replayed"]

LOOKED: set[str] = set()
"""The names of machines at whose variables code has looked after they had ended."""
Status = tuple[str, bool] | None
Choice = tuple[tuple[tuple[str, Any], ...], Request | None, tuple[Status, ...]]
QUESTIONS = 3
"""The most questions of a turn for a machine of another process."""


class Moment(int):
    """A reading of the clock."""

    asked: Callable[[bool, float], None]
    turn: int
    this_turn: Callable[[], int]

    def __sub__(self, other: int) -> Elapsed:  # type: ignore[override]
        elapsed = Elapsed(int(self) - int(other))
        elapsed.asked = self.asked
        # A state in which a machine goes on in place was entered at a sum, which is no reading.
        went_on = not isinstance(other, Moment) and other != NEVER
        elapsed.entered_now = went_on or (isinstance(other, Moment) and other.turn == self.turn)
        return elapsed


class Other:
    """A machine of another process."""

    def __init__(self, state: str, suspended: bool):
        self.state, self.suspended = state, suspended

    def request(self, action: str) -> int:
        return int(self.suspended)


class Cells(Environment):
    """Every slot is a cell."""

    answers: Iterator[Status]

    def __init__(self) -> None:
        super().__init__(ManualClock(START_NS))
        self.cells: dict[str, Any] = {}

    def read(self, machine: str, name: str, sensor: Sensor[Any, Any], slot: Slot[Any]) -> Read:
        return lambda: self.cells.get(slot.name)

    def post(self, machine: str, name: str, actuator: Actuator[Any], slot: Slot[Any]) -> Post:
        def add(message: Any) -> int:
            self.cells[slot.name] = message
            return 0

        return add

    def elsewhere(self, name: str, known: Iterable[str]) -> Any:
        answer = next(self.answers)
        if answer is None:
            raise UnknownMachineError(name, known)
        return Other(*answer)


class Replayed(NamedTuple):
    """The number of states and of turns between them."""

    states: int
    transitions: int


class OverError(BaseException):
    """All choices were made; `turn` is the name of the machine that is next."""

    def __init__(self, turn: str):
        self.turn = turn


class Replay:
    """One run, with the choices of a path."""

    def __init__(self, explorer: Explorer, path: tuple[Choice, ...]):
        self.explorer, self.path, self.turns = explorer, path, 0
        self.world = Cells()
        self.arrangement = Defined(
            explorer.machines, environment=self.world, on_error=explorer.on_error
        )
        self.kernel = self.arrangement.kernel
        self.kernel.unobserved = self.turn  # type: ignore[method-assign]
        self.kernel.bind_all()
        self.outermost = {seat.name: seat for seat in self.arrangement.roster}
        """The seats of all machines so far but inner ones, by name: the last of each."""
        self.begun_in = ""
        self.now_on_turn = ""

    def run(self) -> tuple[str, Seat | None]:
        """Make all choices; return the name of the machine that is next, "" if a round is over."""
        clock: Any = self.world.clock
        while self.turns < len(self.path):
            if self.kernel.rounds:
                clock.advance(ns=self.explorer.period_ns)
            try:
                self.kernel.round()
            except OverError as over:
                return over.turn, self.arrangement.roster.find(over.turn)
        return "", next(iter(self.arrangement.roster), None)

    def turn(self, seat: Seat) -> bool:
        if self.turns == len(self.path):
            raise OverError(seat.name)
        contents, request, answers = self.path[self.turns]
        self.world.answers = iter(answers)
        self.turns += 1
        self.world.cells.update(contents)
        if request is not None:
            if request is Request.RESUME:  # which does not replace a restart, but this does
                seat.schedule(Request.SUSPEND)
            seat.schedule(request)
        self.begun_in, self.now_on_turn = seat.current.name, seat.name
        seat.first_round = 1
        seat.now = self.clock_of(seat)
        try:
            return defined_ringlet(seat)
        finally:
            loaded = (each for each in self.arrangement.roster if not each.inner)
            self.outermost.update((each.name, each) for each in loaded)

    def clock_of(self, seat: Seat) -> Callable[[], int]:
        def asked(entered_now: bool, limit: float) -> None:
            assert seat.name == self.now_on_turn, "only the machine on turn asks for the time"
            assert seat.previous is not None
            state = seat.previous.name if entered_now else self.begun_in
            where, whole = (seat.name, state), int(limit // 1)
            if self.explorer.limits.get(where, -1) < whole:
                self.explorer.limits[where] = whole
                self.explorer.learnt = True

        def now() -> int:
            moment = Moment(self.world.clock.now_ns())
            moment.asked, moment.turn = asked, self.turns
            return moment

        return now

    def goes_on(self) -> bool:
        """Return whether a round may begin: also if a request can have come just now."""
        seats = list(self.arrangement.roster)
        asking = any(seat.name in self.explorer.suspend for seat in seats)
        failed = any(seat.failure is not None for seat in seats)
        return not self.arrangement.finished or asking or failed

    def picture(self, turn: str) -> Any:
        """Return all on which the future depends."""
        cells = tuple(pickle.dumps(self.world.cells.get(name)) for name in self.explorer.kept)
        seats = dict.fromkeys([*self.outermost.values(), *self.arrangement.roster])
        machines = [self.image(seat) for seat in seats]
        return turn, tuple(sorted(machines)), cells

    def image(self, seat: Seat) -> Any:
        elapsed = 0
        if seat.current is seat.previous and seat.taken:
            limit = self.explorer.limits.get((seat.name, seat.current.name), -1)
            elapsed = min(self.world.clock.now_ns() - int(seat.entered_ns), limit + 1)
        return (
            self.stood(seat),
            *(seat.name, seat.current.name, "" if seat.previous is None else seat.previous.name),
            *(seat.remembered.name, str(seat.request), seat.accepted, seat.left, seat.taken),
            *(seat.entered_ns != NEVER, seat.failure is not None, elapsed, self.variables(seat)),
            self.run_images(seat),
        )

    def stood(self, seat: Seat) -> int:
        """Return for how long a machine was in the state in which it is to go on; -1 for none."""
        if not seat.stands or seat.stood is None:
            return -1
        entered_ns, suspended_ns = map(int, seat.stood)
        stops = seat.declared(seat.remembered).clock == "stops"
        until_ns = suspended_ns if stops else self.world.clock.now_ns()
        limit = self.explorer.limits.get((seat.name, seat.remembered.name), -1)
        return min(until_ns - entered_ns, limit + 1)

    def run_images(self, seat: Seat) -> Any:
        states = [state.name for state in seat.table.states if state.runs]
        return tuple(self.run_image(seat, state) for state in states)

    def run_image(self, seat: Seat, state: str) -> Any:
        standing = next((each for each in seat.nest.standing if each.state == state), None)
        inner = seat.nest.seats(seat.states[state])
        return standing and (
            *standing,
            tuple(
                self.image(each)
                if each.parking
                else (each.name, each.accepted, each.left, each.failure is not None, each.taken)
                + ((self.variables(each), self.run_images(each)) if each.name in LOOKED else ())
                for each in inner
            ),
        )

    def variables(self, seat: Seat) -> bytes:
        names = type(seat.machine).table.variables
        return pickle.dumps([(name, getattr(seat.machine, name)) for name in names])


class Explorer:
    """Breadth first over the choices."""

    def __init__(
        self,
        machines: Iterable[type[Machine]],
        period_ns: int,
        domains: dict[str, list[Any]],
        kept: Iterable[str],
        suspend: Collection[str],
        on_error: OnError,
        each_state: Callable[[Iterable[Seat]], object],
        statuses: Iterable[Status],
    ):
        self.statuses = [*statuses]
        self.each_state = each_state
        self.machines = list(machines)
        self.period_ns, self.domains, self.kept = period_ns, domains, sorted(kept)
        self.suspend, self.on_error = suspend, on_error
        self.limits: dict[tuple[str, str], int] = {}
        self.learnt = False

    def run(self) -> Replayed | None:
        looked = len(LOOKED)
        waiting: list[tuple[Choice, ...]] = [()]
        known = {Replay(self, ()).picture("")}
        transitions = 0
        for path in waiting:
            before = Replay(self, path)
            turn, seat = before.run()
            if seat is None or (turn == "" and not before.goes_on()):
                continue
            for choice in self.choices(seat):
                replay = Replay(self, (*path, choice))
                after = replay.picture(replay.run()[0])
                if self.learnt or len(LOOKED) > looked:
                    self.learnt = False
                    return None
                transitions += 1
                self.each_state(replay.outermost.values())
                if after not in known:
                    known.add(after)
                    waiting.append((*path, choice))
        return Replayed(len(known), transitions)

    def choices(self, seat: Seat) -> Iterator[Choice]:
        free = sorted({seat.slot_of(each).name for each in seat.table.sensors.values()})
        free = [name for name in free if name in self.domains]
        requests = [None, *Request] if seat.name in self.suspend else [None]
        for contents in itertools.product(*(self.domains[name] for name in free)):
            for request in requests:
                for answers in itertools.product(self.statuses, repeat=QUESTIONS):
                    yield tuple(zip(free, contents, strict=True)), request, answers


def replayed(
    machines: Iterable[type[Machine]],
    *,
    period_ms: float,
    domains: dict[str, list[Any]] | None = None,
    kept: Iterable[str] = (),
    suspend: Collection[str] = (),
    on_error: OnError = "suspend",
    each_state: Callable[[Iterable[Seat]], object] = tuple,
    statuses: Iterable[Status] = [None],
) -> Replayed:
    """Explore all states; `kept` are the slots that belong to them.

    `each_state` is called with the seats of the outermost machines in each state, also twice.
    `statuses` are those of the only machine of another process.
    """
    LOOKED.clear()
    period_ns = round(period_ms * 1e6)
    explorer = Explorer(
        machines, period_ns, domains or {}, kept, suspend, on_error, each_state, statuses
    )
    found = None
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Submachine, "machine", property(look))
        while found is None:
            found = explorer.run()
    return found


def look(inner: Submachine[Any]) -> Any:
    """Return the machine, and note if it has ended."""
    seat: Any = vars(inner)["_seat"]
    if not (seat.taken or seat.parking):
        LOOKED.add(seat.name)
    return seat.machine
