"""The graph that an automatic layout places: nodes in layers, and how far down each one stands."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TypeAlias

__all__ = ["Arc", "LayerNode", "Layers", "Link", "back_arcs", "ranks"]

Arc: TypeAlias = tuple[int, int]


@dataclass(eq=False, slots=True)
class LayerNode:
    """What takes room in a layer: `left` and `right` of x, and `height` around y."""

    rank: int
    left: float
    right: float
    height: float
    spread: float = 0.0  # the width over which links may end; 0 for a point of a line
    x: float = 0.0
    y: float = 0.0
    above: list[Link] = field(default_factory=list)
    below: list[Link] = field(default_factory=list)


@dataclass(eq=False, slots=True)
class Link:
    """A line from a node down to one in the next layer; it starts and ends beside their x."""

    upper: LayerNode
    lower: LayerNode
    start: float = 0.0
    end: float = 0.0

    def __post_init__(self) -> None:
        self.upper.below.append(self)
        self.lower.above.append(self)


Layers: TypeAlias = list[list[LayerNode]]


def back_arcs(count: int, arcs: Sequence[Arc]) -> set[int]:
    """Return the numbers of arcs without which nodes 0 to `count` form no cycle.

    They are those that a depth-first search from node 0 finds to lead back, and all that lead
    to node 0, which so comes first.
    """
    leaving: list[list[int]] = [[] for _ in range(count)]
    for number, (source, _) in enumerate(arcs):
        leaving[source].append(number)
    back = {number for number, (_, target) in enumerate(arcs) if target == 0}
    done, open_nodes = set[int](), set[int]()
    for root in range(count):
        if root in done:
            continue
        open_nodes.add(root)
        path = [(root, iter(leaving[root]))]
        while path:
            node, rest = path[-1]
            number = next(rest, -1)
            if number < 0:
                path.pop()
                open_nodes.discard(node)
                done.add(node)
                continue
            target = arcs[number][1]
            if target in open_nodes:
                back.add(number)
            elif target not in done:
                open_nodes.add(target)
                path.append((target, iter(leaving[target])))
    return back


def ranks(count: int, arcs: Sequence[Arc], step: int) -> list[int]:
    """Return a rank for each node, at least `step` larger at an arc's end than at its start.

    Arcs must form no cycle. Each node stands as high as it can; those that nothing leads to,
    but node 0, as low as they can.
    """
    below: list[list[int]] = [[] for _ in range(count)]
    waiting = [0] * count
    for source, target in arcs:
        below[source].append(target)
        waiting[target] += 1
    roots = [node for node in range(count) if not waiting[node]]
    rank = [0] * count
    ready = list(roots)
    for node in ready:
        for target in below[node]:
            rank[target] = max(rank[target], rank[node] + step)
            waiting[target] -= 1
            if not waiting[target]:
                ready.append(target)
    for node in roots:
        if node and below[node]:
            rank[node] = min(rank[target] for target in below[node]) - step
    return rank
