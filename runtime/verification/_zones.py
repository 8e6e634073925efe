"""Clocks at any time: the ways that are possible if all machines' clocks run alike.

With any time between rounds, the exploration lets each machine's clock pass its limits whenever it
likes, so a way that it finds may need a clock that runs faster than another. This module decides
which ways are possible, and when their rounds come. All times are whole nanoseconds.

*One way* (`times_of`). Each question about a time in a state asks that a round comes so long, or no
longer, after an earlier one. Such difference constraints are a graph, and Bellman and Ford's
algorithm finds the earliest times, or a circle of constraints that contradict each other.

*All ways* (`possible_ways`). A *zone* is the set of all readings of the clocks with which a state
can be reached, as bounds on each clock and on the difference of each two (a difference bound
matrix; Dill 1989). A search over pairs of a state and a zone ends soon because of four rules, most
of them from UPPAAL:

1. A zone is split only by the machine on turn, at the limits at which its turn begins to do
   something else. A round in which nobody does anything leads back into the zone that it came from.
2. A clock that nobody asks for has no row (active-clock reduction; Daws and Yovine 1996).
3. Beyond the largest limit of a clock's state all readings are alike: such bounds are dropped
   (extrapolation, `Extra_M+` of Behrmann, Bouyer, Larsen and Pelánek 2006). Limits are bounds of
   single clocks, never of differences, so this adds no state that cannot be reached.
4. What is in a zone that was found is not searched again (inclusion), and a zone within a new one
   is given up. So that this is seldom for nothing, a round that was begun is completed first, and
   zones with the widest bounds go first (Herbreteau and Tran 2015, on the order of such searches).
   Rounds are begun in the order of their number, so that a way has as few rounds as possible.

Where machines have little to do with each other, their clocks differ in very many ways that make no
difference to the property. So the first search keeps one zone for each state, the smallest that
includes all (the convex hull of UPPAAL's option -A). If it finds no way, there is none. If it finds
one that is possible (*One way*), that is the answer. Else the next search keeps more zones for each
state before it joins them, and the last one all: it is exact.
"""

from __future__ import annotations

from bisect import bisect_left
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from heapq import heappop, heappush
from math import inf
from operator import itemgetter, le, ne
from typing import NamedTuple, TypeAlias

from llfsm.runtime.verification._breadth_first import Search, Successor
from llfsm.runtime.verification._responses import Responses
from llfsm.runtime.verification.properties import Property

MOST_ZONES = 500_000
ROOMS = (1, 10, 100, inf)
"""How many zones a search keeps for each state before it joins them."""
_MOST_TRIED = 20
"""Ways to one turn that is sought that a search tries, before it leaves it to the next."""
_MOST_JOINED = 30
"""How often zones of a state are joined before bounds that still grow are dropped."""


class TooManyZonesError(Exception):
    """The search for possible ways was given up."""


class Pause(NamedTuple):
    """The least time between two rounds, by their numbers; 0 stands for the beginning."""

    earlier: int
    later: int
    least_ns: int


# One way

_Asked: TypeAlias = tuple[int, int, float]
"""A round, an earlier one, and the least time between them in ns; 0 stands for the beginning."""


def times_of(
    search: Search, steps: Iterable[Successor], pause: Pause | None = None
) -> list[int] | None:
    """Find the earliest time of each round, in nanoseconds; None if there are no such times."""
    asked: list[_Asked] = [] if pause is None else [(pause.later, pause.earlier, pause.least_ns)]
    entered: dict[int, int] = {}
    number = 0
    begins = True
    for step in steps:
        if begins:
            number += 1
            asked.append((number, number - 1, 0))
            for place, limits, passed in search.tables.running(step.ready):
                low_ns, high_ns = _bounds(limits, passed)
                asked.append((number, entered[place], low_ns))
                asked.append((entered[place], number, -high_ns))
        if step.restarted:
            entered[step.place] = number
        begins = step.turn == 0
    return _earliest(asked, number)


def _bounds(limits: Sequence[int], passed: int) -> tuple[int, float]:
    """Bound a time of which `passed` limits are over, in nanoseconds."""
    low_ns = limits[passed - 1] + 1 if passed else 0
    return low_ns, limits[passed] if passed < len(limits) else inf


def _earliest(asked: list[_Asked], rounds: int) -> list[int] | None:
    times: list[float] = [0] * (rounds + 1)
    for _ in range(rounds + 2):
        changed = False
        for later, earlier, least in asked:
            if times[later] < times[earlier] + least:
                times[later] = times[earlier] + least
                changed = True
        if not changed:
            return [int(time) for time in times[1:]]
    return None


# Zones

Zone: TypeAlias = tuple[float, ...]
"""At place `i * size + j`, the most ns by which clock i is ahead of clock j; clock 0 reads 0."""


def constrained(zone: Zone, size: int, clock: int, low_ns: int, high_ns: float) -> Zone | None:
    """Cut a zone to the readings of one clock that lie in a range; None if there are none."""
    if zone[clock * size] > high_ns:
        if zone[clock] + high_ns < 0:
            return None
        zone = _tightened(zone, size, clock, 0, high_ns)
    if zone[clock] > -low_ns:
        if zone[clock * size] < low_ns:
            return None
        zone = _tightened(zone, size, 0, clock, -low_ns)
    return zone


def _tightened(zone: Zone, size: int, one: int, other: int, most: float) -> Zone:
    """Bound how far a clock is ahead of another, and all that follows from that."""
    over = zone[other * size : (other + 1) * size]
    bounds = iter(zone)
    return tuple(
        bound if bound <= (way := first + last) else way
        for first in [each + most for each in zone[one::size]]
        for last, bound in zip(over, bounds, strict=False)  # the next row's bounds stay
    )


def delayed(zone: Zone, most: Sequence[int]) -> Zone:
    """Let any time pass, and forget what makes no difference beyond the clocks' largest limits.

    `most` are the limits, by clock. No clock has an upper bound afterwards, so no bound follows
    from others by way of clock 0.
    """
    size = len(most)
    if size < 2:
        return zone
    first = [max(bound, -limit - 1) for bound, limit in zip(zone, most, strict=False)]
    first[0] = 0
    running = [n for n in range(1, size) if first[n] >= -most[n]]  # others are beyond their limits
    after = [inf] * (size * size)
    after[:size] = first
    for clock in range(1, size):
        after[clock * size + clock] = 0
    dropped = False
    for i in running:
        limit, row = most[i], i * size
        for j in running:
            if (bound := zone[row + j]) <= limit + first[j] or i == j:
                after[row + j] = bound
            else:
                dropped = True
    if dropped and len(running) > 2:
        _close(after, size, running)
    return tuple(after)


def _close(zone: list[float], size: int, clocks: list[int]) -> None:
    """Make each bound between these clocks as tight as the others make it (Floyd)."""
    for k in clocks:
        for i in clocks:
            if (ahead := zone[i * size + k]) != inf:
                row, other = i * size, k * size
                for j in clocks:
                    if (way := ahead + zone[other + j]) < zone[row + j]:
                        zone[row + j] = way


def _joined(one: Zone, other: Zone, size: int, *, loose: bool) -> Zone:
    """Make the smallest zone with both; a `loose` one has no bounds that `other` makes larger."""
    if not loose:
        return tuple(map(max, one, other))
    grown = (inf if bound > was else was for was, bound in zip(one, other, strict=True))
    return tuple(0 if n < size and bound > 0 else bound for n, bound in enumerate(grown))


# All ways


class Way(NamedTuple):
    """A way that is possible: to what was sought, or without a response in time."""

    steps: list[Successor]
    pause: Pause | None = None
    """Of a late response: the time that passes before the last round begins."""
    ends: bool = False
    """True if the execution may end there without the response."""


def possible_ways(
    search: Search,
    sought: Mapping[Property, Callable[[Successor], bool]],
    due: Mapping[Property, Responses],
    found: dict[Property, Way],
) -> None:
    """Find short possible ways to turns that are sought, and to late responses.

    Raise `TooManyZonesError` if there are too many zones, and `TimeUpError` after the deadline;
    those found by then are in `found`.
    """
    zones = _ZoneSearch(search, sought, due, found)
    wanted = {*sought, *due}
    for room in ROOMS:
        if wanted:
            zones.begin(room, wanted)
            zones.run()
            wanted = {prop for prop in zones.tried if prop not in found}


def one_clock(search: Search) -> bool:
    """Check that no two clocks run at once: then each state that was found can be reached."""
    tables = search.tables
    mask = sum(field.mask for field in tables.controls)
    states = (s & mask for level in search.levels for each in level.values() for s in each)
    return all(len([*tables.running(state)]) < 2 for state in set(states))


class _Edge(NamedTuple):
    """The machine's turn while its clock is in a range."""

    step: Successor
    clock: int
    """Its clock in the zone before; 0 if that does not run."""
    low_ns: int
    high_ns: float
    after: _State
    kept: Callable[[Zone], Zone]
    """Takes the bounds of the clocks that run afterwards; a restarted one has those of clock 0."""
    found: tuple[Property, ...]


class _State:
    """A state without the times in it: whose turn is next, and the clocks that run."""

    def __init__(self, search: Search, turn: int, state: int):
        self.turn = turn
        self.state = state
        self.limits = {place: limits for place, limits, _ in search.tables.running(state)}
        self.most = (0, *(limits[-1] for limits in self.limits.values()))
        self.may_end = search.tables.may_end(turn, state)
        self.edges: list[_Edge] | None = None


class _Node:
    """A state and a zone, how they were reached, and the stages of the responses that are due."""

    __slots__ = ("before", "covered", "depth", "due", "state", "zone")

    def __init__(
        self, state: _State, due: tuple[int, ...], zone: Zone, before: tuple[_Node, _Edge] | None
    ):
        self.state, self.due, self.zone, self.before = state, due, zone, before
        self.depth: int = 0 if before is None else before[0].depth + 1
        self.covered = False  # True once its zone is within one that was found later


_Key: TypeAlias = tuple[_State, tuple[int, ...]]
"""A state, and the stages of the responses that are due."""


class _ZoneSearch:
    def __init__(
        self,
        search: Search,
        sought: Mapping[Property, Callable[[Successor], bool]],
        due: Mapping[Property, Responses],
        found: dict[Property, Way],
    ):
        self._search, self._tables = search, search.tables
        self._sought, self._responses, self._found = sought, due, found
        fields, names = self._tables.fields, self._tables.system.names
        self._elapsed = [fields.get(("elapsed", name)) for name in names]
        self._timeless = ~self._tables.packing.mask(("elapsed", name) for name in names)
        self._states: dict[tuple[int, int], _State] = {}

    def begin(self, room: float, wanted: set[Property]) -> None:
        """Prepare a search that keeps as many zones as `room` for each state."""
        self._room, self._wanted = room, wanted
        self.tried: Counter[Property] = Counter()
        """How many ways were found, possible or not, by what they lead to."""
        self._joined: Counter[_Key] = Counter()
        self._nodes: dict[_Key, list[_Node]] = {}
        self._zones = 0
        self._waiting: list[tuple[bool, int, int, int, _Node]] = []

    def run(self) -> None:
        """Search until all that is wanted was found, or there are no more zones."""
        first = self._state(0, self._tables.initial())
        nothing = tuple(responses.done for responses in self._responses.values())
        self._add(_Node(first, self._due(nothing, first), (0,), None))
        while self._waiting and self._wanted:
            node = heappop(self._waiting)[-1]
            if not node.covered:
                self._tables.system.ringlets.deadline.check()
                self._expand(node)

    def _expand(self, node: _Node) -> None:
        """Add what is one turn after a node."""
        before = node.state
        if before.edges is None:
            before.edges = [*self._edges(before)]
        size = len(before.most)
        for edge in before.edges:
            zone: Zone | None = node.zone
            if edge.clock:
                zone = constrained(node.zone, size, edge.clock, edge.low_ns, edge.high_ns)
            if zone is None:
                continue
            zone = edge.kept(zone)
            if edge.after.turn == 0:
                zone = delayed(zone, edge.after.most)
            after = _Node(edge.after, self._due(node.due, edge.after), zone, (node, edge))
            for prop in edge.found:
                self._note(prop, after)
            if before.turn == 0 and edge.high_ns == inf:  # it may begin as late as one likes
                for prop in self._missing(node):
                    self._note(prop, after, late=True)
            self._add(after)

    def _add(self, node: _Node) -> None:
        """Keep a node, unless its zone is within that of another one."""
        key = node.state, node.due
        others = self._nodes.setdefault(key, [])
        zone = node.zone
        if any(all(map(le, zone, other.zone)) for other in others):
            return
        if len(others) >= self._room:
            nearest = min(others, key=lambda other: sum(map(ne, zone, other.zone)))
            self._joined[key] += 1
            zone = node.zone = _joined(
                nearest.zone, zone, len(node.state.most), loose=self._joined[key] > _MOST_JOINED
            )
        for other in others:
            other.covered = all(map(le, other.zone, zone))
        others[:] = [other for other in others if not other.covered]
        others.append(node)
        self._zones += 1
        if self._zones > MOST_ZONES:
            raise TooManyZonesError
        if node.state.may_end:
            for prop in self._missing(node):
                self._note(prop, node, ends=True)
        begins = node.state.turn == 0
        order = begins, node.depth, -zone.count(inf), self._zones
        heappush(self._waiting, (*order, node))

    def _note(self, prop: Property, node: _Node, *, late: bool = False, ends: bool = False) -> None:
        """Keep the way to a node, if it is possible and wanted."""
        if prop in self._wanted:
            self.tried[prop] += 1
            way = self._way(node, prop if late else None)
            if way is not None:
                self._found[prop] = way._replace(ends=ends)
            if way is not None or (self.tried[prop] == _MOST_TRIED and self._room < inf):
                self._wanted = self._wanted - {prop}

    # Responses

    def _due(self, due: tuple[int, ...], state: _State) -> tuple[int, ...]:
        if not due:
            return due
        stages = zip(self._responses.values(), due, strict=True)
        return tuple(each.follow(stage, state.state) for each, stage in stages)

    def _missing(self, node: _Node) -> Iterator[Property]:
        """List the properties of which a response is due."""
        for (prop, responses), stage in zip(self._responses.items(), node.due, strict=True):
            if stage < responses.done:
                yield prop

    # States and what can be done in them

    def _state(self, turn: int, state: int) -> _State:
        key = turn, state & self._timeless
        if key not in self._states:
            self._states[key] = _State(self._search, *key)
        return self._states[key]

    def _edges(self, before: _State) -> Iterator[_Edge]:
        """List the turns from a state, with the ranges of the clock in which they are the same."""
        place = self._on_turn(before)
        limits = before.limits.get(place, ())
        clock = 1 + [*before.limits].index(place) if limits else 0
        ranges: list[tuple[int, float, dict[_Effect, Successor]]] = []
        for number, steps in enumerate(self._steps(before, place, len(limits))):
            low_ns, high_ns = _bounds(limits, number)
            effects = {self._effect(step): step for step in reversed(steps)}
            if ranges and ranges[-1][2].keys() == effects.keys():
                low_ns, _, effects = ranges.pop()
            ranges.append((low_ns, high_ns, effects))
        for low_ns, high_ns, effects in ranges:
            for (after, restarted, found), step in effects.items():
                kept = _kept(before, after, place if restarted else None)
                yield _Edge(step, clock, low_ns, high_ns, after, kept, found)

    def _on_turn(self, state: _State) -> int:
        """Find the first machine from the turn on that has not left."""
        places = range(state.turn, len(self._elapsed))
        return next((n for n in places if self._tables.control(n, state.state).loaded), state.turn)

    def _steps(self, before: _State, place: int, most: int) -> Iterator[list[Successor]]:
        """List the turns for each number of limits of the machine on turn that may be over.

        All other clocks have passed theirs, as what they show makes no difference to it.
        """
        state, field = before.state, self._elapsed[place]
        for other, limits in before.limits.items():
            state |= 0 if other == place else self._passed(other, len(limits))
        if before.turn or not most or field is None:
            for number in range(most + 1):
                yield [*self._search.steps(before.turn, state | self._passed(place, number))]
            return
        steps = [*self._search.steps(0, state)]  # those after any time
        for number in range(most + 1):
            yield [step for step in steps if field.of(step.ready) == number]

    def _passed(self, place: int, number: int) -> int:
        """Make the bits of a state for a number of limits that are over."""
        field = self._elapsed[place]
        return 0 if field is None else number << field.shift

    def _effect(self, step: Successor) -> _Effect:
        found = (prop for prop, decides in self._sought.items() if decides(step))
        return self._state(step.turn, step.state), step.restarted, tuple(found)

    # The way to a node

    def _way(self, node: _Node, late: Property | None) -> Way | None:
        """Find the way to a node, at the earliest times; of a `late` response, after a pause.

        Return None if there are no such times, as zones were joined.
        """
        way: list[tuple[_State, _Edge]] = []
        while node.before is not None:
            node, edge = node.before
            way.append((node.state, edge))
        way.reverse()
        asked: list[_Asked] = []
        entered: dict[int, int] = {}
        number = since = 0
        for before, (step, clock, low_ns, high_ns, *_) in way:
            if late is not None and self._responses[late].triggers(before.state):
                since = number
            if before.turn == 0:
                number += 1
                asked.append((number, number - 1, 0))
            if clock:
                asked.append((number, entered[step.place], low_ns))
                asked.append((entered[step.place], number, -high_ns))
            if step.restarted:
                entered[step.place] = number
        pause = None
        if late is not None and late.within_ms is not None:
            pause = Pause(since, number, round(late.within_ms * 1e6) + 1)
            asked.append((pause.later, pause.earlier, pause.least_ns))
        times = _earliest(asked, number)
        if times is None:
            return None
        return Way([*self._timed([edge.step for _, edge in way], [0, *times])], pause)

    def _timed(self, steps: list[Successor], times: list[int]) -> Iterator[Successor]:
        """Take the same turns at given times, by round: with what all clocks show then."""
        turn, state, number = 0, self._tables.initial(), 0
        entered: dict[int, int] = {}
        for step in steps:
            if turn == 0:
                number += 1
                running = [*self._tables.running(state)]
                state &= self._timeless
                for place, limits, _ in running:
                    elapsed_ns = times[number] - times[entered[place]]
                    state |= self._passed(place, bisect_left(limits, elapsed_ns))
            timed = next(
                each
                for each in self._search.steps(turn, state)
                if (each.round_contents, each.choice) == (step.round_contents, step.choice)
                and (each.ready ^ state) & ~self._timeless == 0
            )
            yield timed
            if timed.restarted:
                entered[timed.place] = number
            turn, state = timed.turn, timed.state


_Effect: TypeAlias = tuple[_State, bool, tuple[Property, ...]]
"""The state after a turn, whether the machine's clock restarts, and what is found."""


def _kept(before: _State, after: _State, restarted: int | None) -> Callable[[Zone], Zone]:
    """Make a function that takes the bounds of the clocks that run after a turn."""
    clocks = [0]
    places = [*before.limits]
    for place in after.limits:
        clocks.append(0 if place == restarted else 1 + places.index(place))
    if len(clocks) == 1:
        return lambda _: (0,)
    size = len(before.most)
    return itemgetter(*(one * size + other for one in clocks for other in clocks))
