"""The naive explorer: it saves and restores a whole arrangement at every single turn.

What `llfsm.runtime.verification` finds is compared with it. The two share nothing: no table of
ringlets, no packing, no opaque time. States are nested tuples in a dictionary.
"""

from __future__ import annotations

import itertools
import pickle
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

from definition import Defined, DefinedKernel
from llfsm.runtime import ExecutionError, Machine, ManualClock
from llfsm.runtime.engine.environment import AgedRead, BoardEnvironment, Post, Read
from llfsm.runtime.engine.events import Request
from llfsm.runtime.engine.kernel import OnError
from llfsm.runtime.engine.ports import Actuator, Sensor
from llfsm.runtime.engine.schedule import Timetable
from llfsm.runtime.engine.seat import NEVER, Failure, Seat
from llfsm.whiteboard import Slot, Whiteboard

__all__ = ["START_NS", "Elapsed", "Explored", "May", "gaps_ns_of", "naively_explored"]

START_NS = 10**15  # more than any limit, so that no state is entered before time began
FAILURE = Failure(ExecutionError("it has failed", "", "", "", None, None), 0)
Domains = Mapping[Slot[Any], Iterable[Any]]
Holds = Callable[[dict[str, Any]], bool]


class Elapsed(int):
    """The time since a state was entered, which notes what it is compared with."""

    asked: Callable[[bool, float], None]
    entered_now: bool

    def __le__(self, limit: float) -> bool:
        self.asked(self.entered_now, limit)
        return int(self) <= limit

    def __gt__(self, limit: float) -> bool:
        self.asked(self.entered_now, limit)
        return int(self) > limit


class Moment(int):
    """A reading of the clock."""

    asked: Callable[[bool, float], None]

    def __sub__(self, other: int) -> Elapsed:  # type: ignore[override]
        elapsed = Elapsed(int(self) - int(other))
        elapsed.asked = self.asked
        elapsed.entered_now = isinstance(other, Moment)  # which is restored as an int
        return elapsed


class World(BoardEnvironment):
    """Every slot is a cell, that of a sensor of the environment, too."""

    def __init__(self, clock: ManualClock):
        super().__init__(Whiteboard.local(), clock)
        self.cells: dict[str, Any] = {}
        self.posted: set[str] = set()
        self.read_by: dict[str, set[str]] = {}
        self.stamps: dict[str, int] = {}
        self.oldest: dict[str, int] = {}
        """By slot, the age in ns above which a message is too old; the same for all machines."""

    def read_aged(
        self,
        machine: str,
        name: str,
        sensor: Sensor[Any, Any],
        slot: Slot[Any],
        start_count: int | None = None,
    ) -> AgedRead:
        self.read_by.setdefault(slot.name, set()).add(machine)
        assert sensor.max_age_ms is not None
        self.oldest[slot.name] = int(sensor.max_age_ms * 1e6)

        def read() -> object:
            is_old = slot.name in self.posted and self.age_ns(slot.name) > self.oldest[slot.name]
            return None if is_old else self.cells.get(slot.name)

        read.start_count = 0  # type: ignore[attr-defined]
        return read  # type: ignore[return-value]

    def age_ns(self, slot: str) -> int:
        """Return how old the message in a slot is; 0 without one, or if nobody asks."""
        if slot not in self.oldest or self.cells.get(slot) is None or slot not in self.posted:
            return 0
        age_ns = self.clock.now_ns() - self.stamps[slot]
        return min(age_ns, self.oldest[slot] + 1)

    def read(self, machine: str, name: str, sensor: Sensor[Any, Any], slot: Slot[Any]) -> Read:
        self.read_by.setdefault(slot.name, set()).add(machine)
        return lambda: self.cells.get(slot.name)

    def post(self, machine: str, name: str, actuator: Actuator[Any], slot: Slot[Any]) -> Post:
        self.posted.add(slot.name)

        def add(message: Any) -> int:
            self.cells[slot.name] = message
            self.stamps[slot.name] = self.clock.now_ns()
            return 0

        return add


class Explored(NamedTuple):
    """All states with their successors, one for each choice, in the order of their finding."""

    successors: dict[Any, list[Any]]
    views: dict[Any, dict[str, Any]]
    """Of each state, by `Machine.state`, `Machine.variable` and a slot's name."""
    ends: set[Any]
    """The states in which the execution may end."""

    fails: bool
    """True if it ends where code raises."""

    @property
    def first(self) -> Any:
        """The initial state."""
        return next(iter(self.successors))

    @property
    def states(self) -> int:
        return len(self.successors)

    @property
    def transitions(self) -> int:
        return sum(map(len, self.successors.values()))

    def unanswered(self, responds: Holds, assumed: Iterable[Holds] = ()) -> set[Any]:
        """Return the states without a response from which none need ever come.

        From each in the greatest fixpoint, all that is `assumed` can come again and again (Emerson
        and Lei); it holds in those in which the execution may end.
        """
        silent = {state for state, view in self.views.items() if not responds(view)}
        again = list(assumed) or [lambda view: True]
        endless = silent
        while True:
            asked = ({s for s in endless if holds(self.views[s])} for holds in again)
            left = endless.intersection(*(self._leading(goals, silent) for goals in asked))
            if left == endless:
                break
            endless = left
        ends = {s for s in silent & self.ends if all(holds(self.views[s]) for holds in again)}
        return endless | ends | self._leading(endless | ends, silent)

    def unanswered_in_turn(self, first: Holds, then: Holds) -> set[Any]:
        """Return the states from which `first`, or after it `then`, need never come."""
        never_then = self.unanswered(then)
        stuck = {s for s in never_then if first(self.views[s])}
        silent = {state for state, view in self.views.items() if not first(view)}
        return self.unanswered(first) | stuck | self._leading(stuck, silent)

    def hopeless(self, goal: Holds) -> set[Any]:
        """Return the states from which no way leads to a goal."""
        goals = {state for state, view in self.views.items() if goal(view)}
        return self.views.keys() - goals - self._leading(goals, set(self.views))

    def _leading(self, goals: set[Any], within: set[Any]) -> set[Any]:
        """Return the states from which one turn or more leads to a goal, `within` some."""
        found: set[Any] = set()
        while True:
            near = goals | found
            new = {s for s in within - found if not near.isdisjoint(self.successors[s])}
            if not new:
                return found
            found |= new

    def late_by(self, responds: Holds, left_ns: int, gaps_ns: list[int]) -> set[Any]:
        """Return the states from which a turn may be due after more than `left_ns` without one.

        `gaps_ns` is the time that passes before each turn of a round.
        """
        known: dict[tuple[Any, int], bool] = {}

        def is_late(state: Any, left_ns: int) -> bool:
            if responds(self.views[state]):
                return False
            if state in self.ends or gaps_ns[state[0]] > left_ns:
                return True
            where, left_ns = (state, left_ns), left_ns - gaps_ns[state[0]]
            if where not in known:
                known[where] = any(is_late(after, left_ns) for after in self.successors[state])
            return known[where]

        return {state for state in self.views if is_late(state, left_ns)}

    def late(self, responds: Holds, rounds: int) -> set[Any]:
        """Return the states from which more than `rounds` rounds may begin without a response."""
        silent = [state for state, view in self.views.items() if not responds(view)]
        silent.sort(key=lambda state: (state[0] != 0, -state[0]))  # as turns depend on later ones
        late: set[Any] = set()
        for left in range(rounds + 1):
            before, late = late, set()
            for state in silent:
                after = self.successors[state]
                if state[0] == 0:
                    found = left == 0 or not before.isdisjoint(after)
                else:
                    found = not late.isdisjoint(after)
                if found or state in self.ends:
                    late.add(state)
        return late


class May(NamedTuple):
    """What the environment may do besides posting."""

    stop: bool = False
    suspend: Collection[str] = ()
    by_rounds: bool = False


_NOTHING = May()


class _FailingKernel(DefinedKernel):
    """A kernel that keeps what code has raised, or suspends its machine without a word."""

    error = ""

    def fail(self, seat: Seat, error: ExecutionError) -> None:
        if self.on_error == "stop":
            self.error = str(error)
        else:
            seat.fail(FAILURE)
            self.set_aside(seat)


class _Naive:
    def __init__(
        self,
        machines: Iterable[type[Machine]],
        periods_ns: Collection[int],
        order: Sequence[tuple[int, int]],
        domains: Domains,
        kept: set[str],
        unload_accepting: bool,
        on_error: OnError,
        may: May,
    ):
        self.may = may
        self.clock = ManualClock(START_NS)
        self.world = World(self.clock)
        self.arrangement = Defined(
            machines,
            environment=self.world,
            unload_accepting=unload_accepting,
            on_error=on_error,
        )
        self.arrangement.kernel.__class__ = _FailingKernel
        self.seats = list(self.arrangement.roster)
        self.periods_ns = periods_ns
        self.order = order or [(number, 0) for number in range(len(self.seats))]
        self.domains = {slot.name: list(messages) for slot, messages in domains.items()}
        shared = self.world.posted & self.world.read_by.keys()
        self.kept = kept
        self.slots = sorted(shared | kept | (self.domains.keys() if may.by_rounds else set()))
        self.begun_in: list[str] = ["" for _ in self.seats]
        self.limits: dict[tuple[int, str], int] = {}
        self.learnt = False
        for index, seat in enumerate(self.seats):
            self._watch(index, seat)

    def _watch(self, index: int, seat: Seat) -> None:
        def asked(entered_now: bool, limit: float) -> None:
            assert seat.previous is not None
            state = seat.previous.name if entered_now else self.begun_in[index]
            where, whole = (index, state), int(limit // 1)
            if not self.learnt and self.limits.get(where, -1) < whole:  # then it starts again
                self.limits[where] = whole
                self.learnt = True

        def now() -> int:
            moment = Moment(self.clock.now_ns())
            moment.asked = asked
            return moment

        seat.first_round = 1
        seat.now = now

    def save(self, turn: int) -> Any:
        now, machines = self.clock.now_ns(), []
        for index, seat in enumerate(self.seats):
            elapsed = 0
            if seat.current is seat.previous and seat.taken:
                limit = self.limits.get((index, seat.current.name), -1)
                elapsed = min(now - int(seat.entered_ns), limit + 1)
            machines.append((
                seat.current.name,
                None if seat.previous is None else seat.previous.name,
                seat.remembered.name,
                seat.request,
                seat.accepted,
                seat.taken,
                seat.entered_ns != NEVER,
                seat.failure is not None,
                elapsed,
                pickle.dumps([(n, getattr(seat.machine, n)) for n in self._variables(seat)]),
            ))  # fmt: skip
        cells = tuple(
            (pickle.dumps(self.world.cells.get(name)), self.world.age_ns(name))
            for name in self.slots
        )
        return (
            turn,
            tuple(machines),
            cells,
            self.arrangement.kernel.stopping,
            self.arrangement.kernel.error,
        )

    def restore(self, state: Any) -> None:
        _, machines, cells, stopping, self.arrangement.kernel.error = state
        self.arrangement.kernel.stopping = self.arrangement.kernel.stop_is_seen = stopping
        now, roster = self.clock.now_ns(), self.arrangement.roster
        for seat, saved in zip(self.seats, machines, strict=True):
            current, previous, remembered, request, accepted, taken, *more = saved
            begun, failed, elapsed, data = more
            seat.failure = FAILURE if failed else None
            found = seat.states | {seat.suspension.name: seat.suspension}
            seat.current, seat.remembered = found[current], found[remembered]
            seat.previous = None if previous is None else found[previous]
            seat.request, seat.accepted = request, accepted
            seat.entered_ns = now - elapsed if begun else NEVER
            if seat.taken is not taken:
                seat.taken = taken
                (roster.add if taken else roster.remove)(seat)
                seat.connect(self.world)
                self._watch(self.seats.index(seat), seat)
            for name, value in pickle.loads(data):
                setattr(seat.machine, name, value)
            seat.machine.stopping = stopping
            self.begun_in[self.seats.index(seat)] = current
        for name, (cell, age_ns) in zip(self.slots, cells, strict=True):
            self.world.cells[name] = pickle.loads(cell)
            self.world.stamps[name] = now - age_ns

    def view(self) -> dict[str, Any]:
        view: dict[str, Any] = dict(self.world.cells)
        for seat in self.seats:
            view[f"{seat.name}.state"] = seat.current.name
            view[f"{seat.name}.has_failed"] = seat.failure is not None
            for name in self._variables(seat):
                view[f"{seat.name}.{name}"] = getattr(seat.machine, name)
        return view

    def successors(self, state: Any) -> Iterator[Any]:
        self.restore(state)
        turn, skipped_ns = self._next(state[0])
        if turn is None or self.arrangement.kernel.error or (state[0] == 0 and not self._goes_on()):
            return
        seat = self.seats[self.order[turn][0]]
        free = [
            name
            for name, readers in sorted(self.world.read_by.items())
            if (state[0] == 0 if self.may.by_rounds else seat.name in readers)
            and name not in self.world.posted
        ]
        requests = [None, *Request] if seat.name in self.may.suspend else [None]
        stops = [False, True] if self.may.stop and not state[3] else [False]
        contents = itertools.product(*(self._contents(name) for name in free))
        until_due = skipped_ns + self.order[turn][1]
        starts = self.periods_ns if state[0] == 0 else [0]
        passed = [until_due + (ns - self.order[0][1] if state[0] == 0 else 0) for ns in starts]
        for chosen, request, stop, ns in itertools.product(contents, requests, stops, passed):
            self.restore(state)
            self.clock.advance(ns=ns)
            self.world.cells.update(zip(free, chosen, strict=True))
            if request is not None:
                if request is Request.RESUME:  # which does not replace a restart, but this does
                    seat.schedule(Request.SUSPEND)
                seat.schedule(request)
            if stop:
                self.arrangement.stop()
            self.arrangement.kernel.give_turns([seat])
            following, skipped_ns = self._next(turn + 1)
            self.clock.advance(ns=skipped_ns)
            after = following or 0
            if self.may.by_rounds and after == 0:
                self.world.cells.update((n, None) for n in self.domains if n not in self.kept)
            yield self.save(after)

    def _contents(self, name: str) -> list[Any]:
        """List the messages that may be in a slot; one may also be too old."""
        domain = self.domains[name]
        return [*domain, None] if name in self.world.oldest and None not in domain else domain

    def _goes_on(self) -> bool:
        """Return whether a round may begin: also if a request can have come just now."""
        stopping, asked = self.arrangement.kernel.stopping, self._asked()
        failed = any(seat.taken and seat.failure is not None for seat in self.seats)
        asking = any(s.suspended or not stopping for s in asked)
        return not self.arrangement.finished or asking or (failed and not stopping)

    def _may_end(self, turn: int) -> bool:
        """Return whether the execution may end where it is; one that is suspended may be held.

        A stop, and a suspend of who would wake, can come before it is decided.
        """
        if self.arrangement.kernel.error:
            return True
        asleep = [seat for seat in self._asked() if seat.suspended]
        others = [seat for seat in self.seats if seat.taken and seat not in asleep]
        if asleep and not (self.arrangement.kernel.stopping or self.may.stop):
            return False
        begun = all(seat.entered_ns != NEVER for seat in asleep)
        return turn == 0 and begun and all(seat.settled for seat in others)

    def _asked(self) -> list[Seat]:
        """Return the loaded machines that anybody may suspend, resume or restart."""
        return [s for s in self.seats if s.taken and s.name in self.may.suspend]

    def run(self) -> Explored | None:
        first = self.save(0)
        explored = Explored({}, {}, set(), fails=False)
        waiting, known = [first], {first}
        for state in waiting:
            after = list(self.successors(state))
            if self.learnt:
                return None
            self.restore(state)
            explored.views[state] = self.view()
            if self._may_end(state[0]):
                explored.ends.add(state)
            explored = explored._replace(fails=explored.fails or bool(state[-1]))
            explored.successors[state] = after
            new = [each for each in dict.fromkeys(after) if each not in known]
            known.update(new)
            waiting += new
        return explored

    def _next(self, turn: int) -> tuple[int | None, int]:
        """Return the first turn from `turn` on whose machine is still loaded.

        With it, the time that passes until the last one that is left out before it.
        """
        skipped_ns = 0
        for number in range(turn, len(self.order)):
            place, gap_ns = self.order[number]
            if self.seats[place].taken:
                return number, skipped_ns
            skipped_ns += gap_ns
        return None, skipped_ns

    def _variables(self, seat: Seat) -> list[str]:
        return list(type(seat.machine).table.variables)


def gaps_ns_of(timetable: Timetable) -> list[int]:
    """Return the time that passes before each turn of a cycle."""
    starts = [slot.start_us * 1_000 for slot in timetable.slots]
    return [
        start - before
        for before, start in pairwise([starts[-1] - timetable.cycle_us * 1_000, *starts])
    ]


def naively_explored(
    machines: Iterable[type[Machine]],
    *,
    period_ms: float | Iterable[float] = (),
    timetable: Timetable | None = None,
    domains: Domains,
    kept: Iterable[Slot[Any]] = (),
    unload_accepting: bool = True,
    on_error: OnError = "stop",
    may: May = _NOTHING,
) -> Explored:
    """Explore all states; `kept` are slots that belong to them though no machine reads them.

    Each round comes after any of several periods, if there are several, or turns are due as in a
    timetable.
    """
    machines = list(machines)
    periods_ms = [period_ms] if isinstance(period_ms, int | float) else period_ms
    periods_ns = [round(ms * 1e6) for ms in periods_ms]
    order: list[tuple[int, int]] = []
    if timetable is not None:
        places = {machine.__name__: place for place, machine in enumerate(machines)}
        turns = (places[slot.machine] for slot in timetable.slots)
        order = list(zip(turns, gaps_ns_of(timetable), strict=True))
        periods_ns = [order[0][1]]
    limits: dict[tuple[int, str], int] = {}
    while True:
        names = {slot.name for slot in kept}
        naive = _Naive(machines, periods_ns, order, domains, names, unload_accepting, on_error, may)
        naive.limits.update(limits)
        explored = naive.run()
        if explored is not None:
            return explored
        limits = naive.limits
