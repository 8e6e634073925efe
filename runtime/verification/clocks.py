"""Whether a way through the states is possible in time, if any time may pass between rounds.

The exploration lets the clocks of several machines pass their limits independently, so a way that
it finds may need a clock that runs faster than another. Here all clocks run alike: for one way by
difference constraints, and for all ways by zones, which are sets of such constraints.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from math import inf
from typing import NamedTuple, TypeAlias

from .breadth_first import Search, Successor

__all__ = ["TooManyZonesError", "possible_way", "times_of"]

_MOST_ZONES = 20_000
Zone: TypeAlias = tuple[tuple[float, ...], ...]
"""Row i, column j: the most by which clock i is ahead of clock j; clock 0 always reads 0."""


class TooManyZonesError(Exception):
    """The search for a possible way was given up."""


class _Bound(NamedTuple):
    """The time in a machine's state, in nanoseconds: more than a limit, up to the next."""

    place: int
    low_ns: int
    high_ns: float


def times_of(search: Search, steps: Iterable[Successor]) -> list[int] | None:
    """Return the earliest time of each round, in nanoseconds; None if there are no such times.

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
    """Return the shortest possible way to a turn that is sought; None if there is none.

    Raise `TooManyZonesError` if there are too many to look at, and `TimeUpError`.
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
    """Return what is known of the clocks that run where a round begins."""
    for place, limits, number in search.tables.running(ready):
        low_ns = limits[number - 1] + 1 if number else 0
        yield _Bound(place, low_ns, limits[number] if number < len(limits) else inf)


def _close(zone: list[list[float]]) -> bool:
    """Make each bound as tight as the others make it; return False if they contradict."""
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
    """Forget what no limit asks about, so that there is an end of zones."""
    for i, row in enumerate(zone):
        for j, bound in enumerate(row):
            if i != j:
                row[j] = inf if bound > most[i] else max(bound, -most[j])
    _close(zone)
    return tuple(map(tuple, zone))
