"""Responses that must come, ways that must stay: lassos without responses, regions with no way out.

*Liveness* (`late_response`, `no_response`). From the states in which a response is due, the search
goes on without those that respond. With a time limit, a way on which a turn is due later violates
the property. Without one, a cycle does, or an end of the execution. Cycles are in the strongly
connected components of the graph (Tarjan 1972); assumptions are fairness: a component counts if it
has a state for each (the acceptance of a generalized Büchi automaton). The counterexample is a
*lasso*: a way to a state and a cycle back to it, both short. What must follow may be several
responses, one after the other: the number of those that have come is the *stage*, and the search is
one of states with their stages. That something holds for ever from some point on is the same
search: for a cycle in which it fails again and again, from the initial state.

*Possibility* (`no_way_out`). The states from which some way leads to a goal are found backwards
from the goals. All others are regions without a way out: what follows one of them is another one.
The nearest is the counterexample; there, too, every execution has a cycle or an end.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import accumulate, chain, islice, repeat
from typing import NamedTuple, TypeAlias

from llfsm.runtime.verification._breadth_first import Search
from llfsm.runtime.verification._twin import States

Node: TypeAlias = tuple[int, int, int]
"""Whose turn is next, the state, and the stage: how many responses have come."""
Holds: TypeAlias = Callable[[int], bool]
"""A predicate of a state."""
Sources: TypeAlias = Sequence[list[Node]]
"""By level of the search, the states from which a response is due."""


class Responses(NamedTuple):
    """The answer due to a trigger: one or more responses, one after the other."""

    triggers: Holds
    each: tuple[Holds, ...]

    @property
    def done(self) -> int:
        """The stage in which nothing is due."""
        return len(self.each)

    def advance(self, stage: int, state: int) -> int:
        """Return the stage after a state, in which several responses may come."""
        while stage < len(self.each) and self.each[stage](state):
            stage += 1
        return stage

    def follow(self, stage: int, state: int) -> int:
        """Return the stage after a state that may be a trigger, too."""
        return self.advance(0 if self.triggers(state) else stage, state)

    def silent(self, search: Search, node: Node) -> list[Node]:
        """List what may be one turn after a node while a response is due."""
        turn, state, stage = node
        found = ((*each, self.advance(stage, each[1])) for each in search.after(turn, state))
        return [after for after in found if after[2] < self.done]


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
    search: Search, sources: Sources, responses: Responses, units: int
) -> Lasso | None:
    """Find the shortest way on which a turn is due after more units without a response."""
    order = search.tables.system.order
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
            turn, state, stage = node
            until_due = passed + order[turn].units
            if search.tables.may_end(turn, state):
                return Lasso(_way((node, passed), parents), [], ends=True)
            if until_due > units:
                late = *search.after(turn, state)[0], stage
                return Lasso([*_way((node, passed), parents), late], [])
            for after in responses.silent(search, node):
                item = after, until_due
                if item not in parents:
                    parents[item] = node, passed
                    level.append(item)
    return None


def no_response(
    search: Search,
    sources: Sources,
    responses: Responses,
    recurring: Sequence[Holds],
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
            turn, state, _ = node
            if search.tables.may_end(turn, state) and all(holds(state) for holds in recurring):
                ends.add(node)
            edges[node] = responses.silent(search, node)
            for after in edges[node]:
                if (after, 0) not in parents:
                    parents[after, 0] = node, 0
                    level.append(after)
    fair = {
        node: component
        for component in _components(edges)
        if all(any(holds(state) for _, state, _ in component) for holds in recurring)
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
    recurring: Sequence[Holds],
) -> list[Node]:
    """Find a cycle from `start`, which ends it, with a state for each that recurs."""
    cycle = [start]
    for holds in recurring:
        if not any(holds(state) for _, state, _ in cycle):
            good = {node for node in component if holds(node[1])}
            cycle += _shortest(cycle[-1], component, edges, good)
    cycle += _shortest(cycle[-1], component, edges, {start})
    return cycle[1:]


def _shortest(
    start: Node,
    component: set[Node],
    edges: dict[Node, list[Node]],
    sought: set[Node],
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
                if after in sought:
                    way = [after]
                    while (before := parents[way[-1]]) != start:
                        way.append(before)
                    return way[::-1]
                level.append(after)


class Trap(NamedTuple):
    """A region without a way out: its first state, and the number of states that can follow."""

    turn: int
    state: int
    states: int


def no_way_out(search: Search, others: Callable[[States], States]) -> Trap | None:
    """Find the nearest state from which no way leads to a goal; None if there is none.

    `others` selects those of some states that are no goals: only these take memory.
    """
    rest = [(turn, others(each)) for level in search.levels for turn, each in level.items()]
    numbers: dict[int, dict[int, int]] = {}
    """By turn and state, in the order in which they were found."""
    count = 0
    for turn, states in rest:
        search.tables.system.ringlets.deadline.check()
        numbers.setdefault(turn, {}).update(
            zip(states, range(count, count + len(states)), strict=True)
        )
        count += len(states)
    good = bytearray(count)
    ends, targets = array("Q", [0]), array("Q")  # the successors of each state that are no goals
    for number, (turn, state) in enumerate(_each(rest)):
        for next_turn, after in search.after(turn, state):
            target = numbers.get(next_turn, {}).get(after)
            if target is None:
                good[number] = 1
            else:
                targets.append(target)
        ends.append(len(targets))
    known = [number for number, found in enumerate(good) if found]
    sources, before = _reversed(ends, targets)
    for number in known:
        for earlier in before[sources[number] : sources[number + 1]]:
            if not good[earlier]:
                good[earlier] = 1
                known.append(earlier)
    first = good.find(0)
    if first < 0:
        return None
    region, waiting = {first}, [first]
    for number in waiting:
        new = set(targets[ends[number] : ends[number + 1]]) - region
        region |= new
        waiting += new
    return Trap(*next(islice(_each(rest), first, None)), len(region))


def _each(rest: Iterable[tuple[int, States]]) -> Iterator[tuple[int, int]]:
    return ((turn, state) for turn, states in rest for state in states)


def _reversed(ends: array[int], targets: array[int]) -> tuple[array[int], array[int]]:
    """Turn the edges of a graph round; those of a node are from its place in `ends` to the next."""
    counts = [0] * len(ends)
    for target in targets:
        counts[target + 1] += 1
    begins = array("Q", accumulate(counts))
    free, sources = begins[:], array("Q", targets)
    for source in range(len(ends) - 1):
        for target in targets[ends[source] : ends[source + 1]]:
            sources[free[target]] = source
            free[target] += 1
    return begins, sources
