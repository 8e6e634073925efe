"""Executions: those in which a response never comes or comes too late, and those possible in time.

*Liveness* (`late_response`, `no_response`). From the states in which a response is due, the search
goes on without those that respond. With a time limit, a way on which too many rounds begin violates
the property. Without one, a cycle does, or an end of the execution. Cycles are in the strongly
connected components of the graph (Tarjan 1972); assumptions are fairness: a component counts if it
has a state for each (the acceptance of a generalized Büchi automaton). The counterexample is a
*lasso*: a way to a state and a cycle back to it, both short.

*Clocks* (`times_of`, `possible_way`). With any time between rounds, the exploration lets the clocks
of several machines pass their limits independently, so a way that it finds may need a clock that
runs faster than another. Here all clocks run alike: for one way by difference constraints, and for
all ways by zones, which are sets of such constraints, as for timed automata (Dill 1989).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import chain, repeat
from math import inf
from typing import NamedTuple, TypeAlias

from llfsm.runtime.verification._breadth_first import Search, Successor

_MOST_ZONES = 20_000
Zone: TypeAlias = tuple[tuple[float, ...], ...]
"""Row i, column j: the most ns by which clock i is ahead of clock j; clock 0 always reads 0."""


class TooManyZonesError(Exception):
    """The search for a possible way was given up."""


class _Bound(NamedTuple):
    """The time in a machine's state, in nanoseconds: more than a limit, up to the next."""

    place: int
    low_ns: int
    high_ns: float


def times_of(search: Search, steps: Iterable[Successor]) -> list[int] | None:
    """Find the earliest time of each round, in nanoseconds; None if there are no such times.

    Each bound asks that one round comes so long, or no longer, after another. Bellman and Ford's
    algorithm raises the times until all hold; if that takes too often, they contradict each other.
    """
    asked: list[tuple[int, int, float]] = []  # round, the one before it, least time between
    entered: dict[int, int] = {}
    number = 0
    begins = True
    for step in steps:
        if begins:
            number += 1
            asked.append((number, number - 1, 0))
            for bound in _bounds(search, step.ready):
                since = entered[bound.place]
                asked.append((number, since, bound.low_ns))
                asked.append((since, number, -bound.high_ns))
        if step.restarted:
            entered[step.place] = number
        begins = step.turn == 0
    times: list[float] = [0] * (number + 1)
    for _ in range(number + 2):
        changed = False
        for later, earlier, least in asked:
            if times[later] < times[earlier] + least:
                times[later] = times[earlier] + least
                changed = True
        if not changed:
            return [int(time) for time in times[1:]]
    return None


def possible_way(search: Search, sought: Callable[[Successor], bool]) -> list[Successor] | None:
    """Find the shortest possible way to a turn that is sought; None if there is none.

    Raise `TooManyZonesError` if there are too many zones, and `TimeUpError` after the deadline.
    """
    size = len(search.tables.system.names) + 1
    most = [0.0]
    for limits in search.tables.system.limits:
        most.append(max((each[-1] + 1 for each in limits.values() if each), default=0))
    first = 0, search.tables.initial(), tuple((0.0,) * size for _ in range(size))
    parents: dict[tuple[int, int, Zone], tuple[tuple[int, int, Zone], Successor] | None] = {
        first: None
    }
    level = [first]
    while level:
        now, level = level, []
        for node in now:
            search.tables.system.ringlets.deadline.check()
            for step, zone in _zones_after(search, node, most):
                after = step.turn, step.state, zone
                if sought(step):
                    return [*_steps_to(node, parents), step]
                if after not in parents:
                    parents[after] = node, step
                    level.append(after)
        if len(parents) > _MOST_ZONES:
            raise TooManyZonesError
    return None


def _steps_to(
    node: tuple[int, int, Zone],
    parents: dict[tuple[int, int, Zone], tuple[tuple[int, int, Zone], Successor] | None],
) -> list[Successor]:
    steps = []
    while (before := parents[node]) is not None:
        node, step = before
        steps.append(step)
    return steps[::-1]


def _zones_after(
    search: Search, node: tuple[int, int, Zone], most: list[float]
) -> Iterator[tuple[Successor, Zone]]:
    turn, state, before = node
    for step in search.steps(turn, state):
        zone = [list(row) for row in before]
        if turn == 0:
            for row in zone[1:]:
                row[0] = inf  # time passes
            for bound in _bounds(search, step.ready):
                clock = bound.place + 1
                zone[0][clock] = min(zone[0][clock], -bound.low_ns)
                zone[clock][0] = min(zone[clock][0], bound.high_ns)
            if not _close(zone):
                continue
        if step.restarted:
            _restart(zone, step.place + 1)
        yield step, _rounded(zone, most)


def _bounds(search: Search, ready: int) -> Iterator[_Bound]:
    """Bound the clocks that run where a round begins."""
    for place, limits, number in search.tables.running(ready):
        low_ns = limits[number - 1] + 1 if number else 0
        yield _Bound(place, low_ns, limits[number] if number < len(limits) else inf)


def _close(zone: list[list[float]]) -> bool:
    """Make each bound as tight as the others make it (Floyd); return False if they contradict."""
    size = range(len(zone))
    for k in size:
        for i in size:
            for j in size:
                zone[i][j] = min(zone[i][j], zone[i][k] + zone[k][j])
    return all(zone[i][i] >= 0 for i in size)


def _restart(zone: list[list[float]], clock: int) -> None:
    zone[clock] = list(zone[0])
    for row in zone:
        row[clock] = row[0]
    zone[clock][clock] = 0


def _rounded(zone: list[list[float]], most: list[float]) -> Zone:
    """Forget bounds beyond the largest limit of a clock, so that there is an end of zones."""
    for i, row in enumerate(zone):
        for j, bound in enumerate(row):
            if i != j:
                row[j] = inf if bound > most[i] else max(bound, -most[j])
    _close(zone)
    return tuple(map(tuple, zone))


Node: TypeAlias = tuple[int, int]
"""Whose turn is next, and the state."""
Sources: TypeAlias = Sequence[list[Node]]
"""By level of the search, the states from which a response is due."""


_MOST_TRIED = 100
"""States of which the cycles are compared, the nearest first, to find a short one."""


class Lasso(NamedTuple):
    """A way from a state in which a response is due, and a cycle that its last state begins.

    Without a cycle the time is over, or the execution ends there.
    """

    stem: list[Node]
    cycle: list[Node]
    ends: bool = False


def late_response(
    search: Search, sources: Sources, responds: Callable[[Node], bool], rounds: int
) -> Lasso | None:
    """Find the shortest way on which more than `rounds` rounds begin without a response."""
    waited: dict[Node, int] = {}
    parents: dict[tuple[Node, int], tuple[Node, int] | None] = {}
    level: list[tuple[Node, int]] = []
    for begun in chain(sources, repeat(None)):
        if begun is None and not level:
            break
        begun = begun or []
        for node in begun:
            parents.setdefault((node, 0), None)
        level, now = [], [*level, *((node, 0) for node in begun)]
        for node, passed in now:
            if waited.get(node, -1) >= passed:
                continue
            waited[node] = passed
            successors = search.after(*node)
            after_round = passed + (node[0] == 0)
            if search.tables.may_end(*node):
                return Lasso(_way((node, passed), parents), [], ends=True)
            if after_round > rounds:
                return Lasso([*_way((node, passed), parents), successors[0]], [])
            for after in successors:
                item = after, after_round
                if item not in parents and not responds(after):
                    parents[item] = node, passed
                    level.append(item)
    return None


def no_response(
    search: Search,
    sources: Sources,
    responds: Callable[[Node], bool],
    recurring: Sequence[Callable[[Node], bool]],
) -> Lasso | None:
    """Find a short way to a cycle, or an end, without a response but with all that recurs."""
    parents: dict[tuple[Node, int], tuple[Node, int] | None] = {}
    edges: dict[Node, list[Node]] = {}
    ends: set[Node] = set()
    level: list[Node] = []
    for begun in chain(sources, repeat(None)):
        if begun is None and not level:
            break
        begun = begun or []
        for node in begun:
            parents.setdefault((node, 0), None)
        level, now = [], [*level, *begun]
        for node in now:
            if node in edges:
                continue
            successors = search.after(*node)
            if search.tables.may_end(*node) and all(holds(node) for holds in recurring):
                ends.add(node)
            edges[node] = [after for after in successors if not responds(after)]
            for after in edges[node]:
                if (after, 0) not in parents:
                    parents[after, 0] = node, 0
                    level.append(after)
    fair = {
        node: component
        for component in _components(edges)
        if all(any(holds(node) for node in component) for holds in recurring)
        for node in component
    }
    found: Lasso | None = None
    tried = 0
    for node in edges:  # in the order of their distances
        if node in ends or (node in fair and tried < _MOST_TRIED):
            tried += 1
            stem = _way((node, 0), parents)
            if found is not None and len(stem) >= len(found.stem) + len(found.cycle):
                break
            cycle = [] if node in ends else _cycle(node, fair[node], edges, recurring)
            if found is None or len(stem) + len(cycle) < len(found.stem) + len(found.cycle):
                found = Lasso(stem, cycle, ends=not cycle)
    return found


def _way(
    item: tuple[Node, int], parents: dict[tuple[Node, int], tuple[Node, int] | None]
) -> list[Node]:
    way = [item[0]]
    before = parents[item]
    while before is not None:
        way.append(before[0])
        before = parents[before]
    return way[::-1]


def _components(edges: dict[Node, list[Node]]) -> Iterable[set[Node]]:
    """Find the strongly connected components that have a cycle (Tarjan), without recursion."""
    numbers: dict[Node, int] = {}
    lowest: dict[Node, int] = {}
    open_nodes: list[Node] = []
    on_stack: set[Node] = set()
    for root in edges:
        if root in numbers:
            continue
        work = [(root, iter(edges[root]))]
        numbers[root] = lowest[root] = len(numbers)
        open_nodes.append(root)
        on_stack.add(root)
        while work:
            node, rest = work[-1]
            for after in rest:
                if after not in numbers:
                    numbers[after] = lowest[after] = len(numbers)
                    open_nodes.append(after)
                    on_stack.add(after)
                    work.append((after, iter(edges[after])))
                    break
                if after in on_stack:
                    lowest[node] = min(lowest[node], numbers[after])
            else:
                work.pop()
                if work:
                    before = work[-1][0]
                    lowest[before] = min(lowest[before], lowest[node])
                if lowest[node] == numbers[node]:
                    component = {node}
                    while (last := open_nodes.pop()) != node:
                        component.add(last)
                    on_stack -= component
                    if len(component) > 1 or node in edges[node]:
                        yield component


def _cycle(
    start: Node,
    component: set[Node],
    edges: dict[Node, list[Node]],
    recurring: Sequence[Callable[[Node], bool]],
) -> list[Node]:
    """Find a cycle from `start`, which ends it, with a state for each that recurs."""
    cycle = [start]
    for holds in recurring:
        if not any(holds(node) for node in cycle):
            cycle += _shortest(cycle[-1], component, edges, holds)
    cycle += _shortest(cycle[-1], component, edges, lambda node: node == start)
    return cycle[1:]


def _shortest(
    start: Node,
    component: set[Node],
    edges: dict[Node, list[Node]],
    sought: Callable[[Node], bool],
) -> list[Node]:
    """List the nodes after `start` on the shortest way, of one turn or more, to one sought."""
    parents: dict[Node, Node] = {}
    level = [start]
    while True:
        now, level = level, []
        for node in now:
            for after in edges[node]:
                if after not in component or after in parents:
                    continue
                parents[after] = node
                if sought(after):
                    way = [after]
                    while (before := parents[way[-1]]) != start:
                        way.append(before)
                    return way[::-1]
                level.append(after)
