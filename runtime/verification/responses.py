"""Liveness: find an execution in which a response never comes, or comes too late."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from itertools import chain, repeat
from typing import NamedTuple, TypeAlias

from .breadth_first import Search

__all__ = ["Lasso", "Node", "late_response", "no_response"]

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
    """Return the shortest way on which more than `rounds` rounds begin without a response."""
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
    """Return a short way to a cycle, or an end, without a response but with all that recurs."""
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
    """Return the strongly connected components that have a cycle (Tarjan), without recursion."""
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
    """Return a cycle from `start`, which ends it, with a state for each that recurs."""
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
    """Return the nodes after `start` on the shortest way, of one turn or more, to one sought."""
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
