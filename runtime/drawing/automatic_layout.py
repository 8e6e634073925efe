"""A machine in layers from its initial state down, the labels in layers of their own.

This is the method of Sugiyama, Tagawa and Toda (1981), in which a label is a node as a state is:
nothing that is drawn can then cover a label, as nothing in layers overlaps.

1. *Layers.* Arcs that close a cycle are turned round (`back_arcs`), and each node gets a rank below
   those that lead to it, in steps of two: between two layers of states is one for labels (`ranks`).
   An arrow becomes a chain of nodes, one in every layer that it passes; the node next to its source
   is its label, where a reader asks which transition fires. All others are thin.
2. *Order.* Each layer is sorted by the mean places of its nodes' neighbours, downwards and upwards
   in turns, and the order with the fewest crossings is kept (`_sort`).
3. *Columns.* The method of Brandes and Köpf (2001): nodes are aligned with a median neighbour into
   blocks, the blocks pushed together, once for each of the four corners, and the four results
   balanced, so that long arrows run straight (`set_columns`).
4. *Rows and curves.* Layers are as high as their nodes, and farther apart where arrows lead far to
   the side. A curve is vertical within a layer and bends between two. Transitions from a state to
   itself are loops at its right side, for which its node has room.

Everything is in a fixed order, so that equal machines give equal diagrams.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from operator import itemgetter
from typing import TypeAlias

from llfsm.runtime.drawing.curves import Curve, Point, through
from llfsm.runtime.drawing.diagram import Arrow, Box, Edge, Label

_GAP = 20.0  # between neighbours in a layer
_LAYER_GAP = 16.0  # between layers, more where links lead far to the side
_SLOPE = 0.1  # of that way to the side, which the gap grows by
_MOST = 40.0  # that it grows by
_ENDS = 26.0  # between the ends of links at a node
_SORTINGS = 24  # of all layers, at most
_THIN = 5.0  # half the room for a line that passes a layer
_PORT_GAP = 12.0  # the least distance of two arrows at a box
_STUB = 12.0  # of an arrow that is straight, above and below a box
_CORNERS = 24.0  # of a box's width, where no arrows are
_LOOP_HEIGHT = 32.0
_LOOP_END = 8.0  # from a loop's middle to its ends
_LOOP_SWING = 2.2  # how much wider a loop is than at its ends
_LOOP_REACH = 28.0
_LOOP_GAP = 3.0

Arc: TypeAlias = tuple[int, int]
"""Where an arrow starts and ends, as indices into the list of boxes."""


@dataclass(eq=False, slots=True)
class Node:
    """A node with its room: `left` and `right` of x, and `height` around y."""

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

    upper: Node
    lower: Node
    start: float = 0.0
    end: float = 0.0

    def __post_init__(self) -> None:
        self.upper.below.append(self)
        self.lower.above.append(self)


Layers: TypeAlias = list[list[Node]]


def automatic_layout(boxes: Sequence[Box], arrows: Sequence[Arrow]) -> tuple[list[Box], list[Edge]]:
    """Place boxes, the first at the top, and route arrows between them."""
    between = [arrow for arrow in arrows if arrow.source != arrow.target]
    arcs = [(arrow.source, arrow.target) for arrow in between]
    back = back_arcs(len(boxes), arcs)
    down = [arc[::-1] if i in back else arc for i, arc in enumerate(arcs)]
    rank = ranks(len(boxes), down, step=2)  # a layer for labels below each layer of boxes
    loops = [[a for a in arrows if a.source == a.target == i] for i in range(len(boxes))]
    boxes = [_roomy(box, i, loops[i], down) for i, box in enumerate(boxes)]
    nodes = []
    for box, at, own in zip(boxes, rank, loops, strict=True):
        right = box.width / 2 + loop_room([arrow.label for arrow in own])[0]
        height, spread = box.height + 2 * _STUB, box.width - _CORNERS
        nodes.append(Node(at - min(rank), box.width / 2, right, height, spread))
    chains = [
        _chain(nodes, nodes[upper], nodes[lower], arrow, number in back)
        for number, (arrow, (upper, lower)) in enumerate(zip(between, down, strict=True))
    ]
    bands = place(nodes)
    placed = [replace(box, x=node.x, y=node.y) for box, node in zip(boxes, nodes, strict=False)]
    edges = []
    for number, (arrow, (links, written)) in enumerate(zip(between, chains, strict=True)):
        upper, lower = down[number]
        curve = _route(links, bands, placed[upper].bottom, placed[lower].top)
        label = replace(arrow.label, x=written.x, y=written.y)
        edges.append(arrow.edge(placed, curve[::-1] if number in back else curve, label))
    for box, own in zip(placed, loops, strict=True):
        labels = [arrow.label for arrow in own]
        for arrow, (curve, label) in zip(own, self_loops(box, labels), strict=True):
            edges.append(arrow.edge(placed, curve, label))
    return placed, edges


def _roomy(box: Box, i: int, loops: Sequence[Arrow], down: Sequence[Arc]) -> Box:
    """Widen a box to have room for the ends of all its arrows."""
    ends = max(sum(upper == i for upper, _ in down), sum(lower == i for _, lower in down))
    return replace(
        box,
        width=max(box.width, _CORNERS + _PORT_GAP * (ends - 1)),
        height=max(box.height, loop_room([arrow.label for arrow in loops])[1]),
    )


def _chain(
    nodes: list[Node], upper: Node, lower: Node, arrow: Arrow, backwards: bool
) -> tuple[list[Link], Node]:
    """Join two nodes through every layer between; return the links and the label's node.

    The label is next to the source, where one asks which transition fires.
    """
    label_rank = lower.rank - 1 if backwards else upper.rank + 1
    links: list[Link] = []
    here = written = upper
    for rank in range(upper.rank + 1, lower.rank):
        if rank == label_rank:
            half = arrow.label.width / 2
            after = written = Node(rank, half, half, arrow.label.height)
        else:
            after = Node(rank, _THIN, _THIN, 0)
        nodes.append(after)
        links.append(Link(here, after))
        here = after
    links.append(Link(here, lower))
    return links, written


def _route(
    links: Sequence[Link], bands: Sequence[tuple[float, float]], start: float, end: float
) -> Curve:
    """Draw a curve along links: it crosses layers vertically, and bends between them."""
    first, last = links[0], links[-1]
    x = first.upper.x + first.start
    points = [Point(x, start), Point(x, bands[first.upper.rank][1])]
    for link in links[:-1]:
        top, bottom = bands[link.lower.rank]
        points += Point(link.lower.x, top), Point(link.lower.x, bottom)
    x = last.lower.x + last.end
    points += Point(x, bands[last.lower.rank][0]), Point(x, end)
    return through(points)


def loop_room(labels: Sequence[Label]) -> tuple[float, float]:
    """Return the width that loops take beside their box, and the height of it that they need."""
    width = max((_LOOP_REACH + _LOOP_GAP + label.width for label in labels), default=0)
    return width, len(labels) * _pitch(labels)


def self_loops(box: Box, labels: Sequence[Label], side: int = 1) -> list[tuple[Curve, Label]]:
    """Draw loops at the right of a box, or the left if `side` is -1, the first at the top.

    Their labels are in their places.
    """
    pitch = min(_pitch(labels), box.height / max(len(labels), 1))  # an editor's box may be small
    end = min(_LOOP_END, 0.4 * pitch)
    y = box.y - (len(labels) - 1) / 2 * pitch
    border = box.right if side > 0 else box.left
    reach = side * _LOOP_REACH / 0.75  # to control points: a curve goes 3/4 of the way to them
    loops: list[tuple[Curve, Label]] = []
    for label in labels:
        curve = (
            Point(border, y - end),
            Point(border + reach, y - _LOOP_SWING * end),
            Point(border + reach, y + _LOOP_SWING * end),
            Point(border, y + end),
        )
        beside = replace(label, x=border + side * (_LOOP_REACH + _LOOP_GAP + label.width / 2), y=y)
        loops.append((curve, beside))
        y += pitch
    return loops


def _pitch(labels: Sequence[Label]) -> float:
    return max((_LOOP_HEIGHT, *(label.height + 4 for label in labels)))


# Layers


def back_arcs(count: int, arcs: Sequence[Arc]) -> set[int]:
    """Return the numbers of arcs without which nodes 0 to `count` form no cycle.

    They are those that a depth-first search from node 0 finds to lead back, and all that lead
    to node 0, which so comes first. Without recursion, as a machine may have thousands of states.
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
    """Rank nodes, at least `step` larger at an arc's end than at its start.

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


# Order


def place(nodes: list[Node]) -> list[tuple[float, float]]:
    """Give nodes and the ends of links their places; return top and bottom of each layer."""
    layers: Layers = [[] for _ in range(max(node.rank for node in nodes) + 1)]
    for node in nodes:
        layers[node.rank].append(node)
    _sort(layers)
    set_columns(layers)
    for node in nodes:
        if node.spread:
            _spread_links(node)
    return _set_rows(layers)


def _sort(layers: Layers) -> None:
    """Order each layer by the barycentres of its neighbours, keeping the best order seen.

    Nodes are numbers here, and so are their places in their layers: most of the time goes by here.
    """
    nodes = [node for layer in layers for node in layer]
    number = {node: i for i, node in enumerate(nodes)}
    rows = [[number[node] for node in layer] for layer in layers]
    above = [[number[link.upper] for link in node.above] for node in nodes]
    below = [[number[link.lower] for link in node.below] for node in nodes]
    place = [0] * len(nodes)
    for row in rows:
        _number(row, place)
    best, fewest = rows, _crossings(rows, below, place)
    seen = [rows, rows]  # after the last two turns
    for turn in range(_SORTINGS):
        if not fewest:
            break
        down = turn % 2 == 0
        near = above if down else below
        turned = [_sorted(row, near, place) for row in (rows if down else reversed(rows))]
        rows = turned if down else turned[::-1]
        if rows == seen[0] and turn > 1:
            break  # the turns repeat themselves
        seen = [seen[1], rows]
        crossings = _crossings(rows, below, place)
        if crossings < fewest:
            best, fewest = rows, crossings
    layers[:] = [[nodes[i] for i in row] for row in best]


def _sorted(row: list[int], near: list[list[int]], place: list[int]) -> list[int]:
    """Sort a row by the mean places of its nodes' neighbours; those without any stay."""
    wishes = [
        place[others[0]] if len(others := near[i]) == 1 else _mean(others, place, i) for i in row
    ]
    if wishes == sorted(wishes):
        return row
    row = [row[at] for at in sorted(range(len(row)), key=wishes.__getitem__)]
    _number(row, place)
    return row


def _mean(others: list[int], place: list[int], i: int) -> float:
    return sum([place[other] for other in others]) / len(others) if others else place[i]


def _number(row: list[int], place: list[int]) -> None:
    for at, i in enumerate(row):
        place[i] = at


def _crossings(rows: list[list[int]], below: list[list[int]], place: list[int]) -> int:
    """Count the crossings of links; those of one node do not cross each other."""
    crossings = sum(_inversions([place[other] for i in row for other in below[i]]) for row in rows)
    forks = [others for others in below if len(others) > 1]
    return crossings - sum(_inversions([place[other] for other in others]) for others in forks)


def _inversions(ends: list[int]) -> int:
    """Count the pairs that are not in order, by inserting into a sorted list."""
    if ends == sorted(ends):
        return 0
    inversions = 0
    before: list[int] = []  # sorted
    for end in ends:
        at = bisect_right(before, end)
        inversions += len(before) - at
        before.insert(at, end)
    return inversions


# Columns and rows


_at = itemgetter(0)


def set_columns(layers: Layers) -> None:
    """Set the x of all nodes: of four extreme placements, the mean of the middle two."""
    crossed = _crossed(layers)
    found: list[dict[Node, float]] = []
    for upward in (False, True):
        for mirrored in (False, True):
            view = [layer[::-1] if mirrored else layer for layer in layers]
            block = _blocks(view[::-1] if upward else view, upward, crossed)
            x = _compact(view, block, mirrored)
            found.append({node: -at for node, at in x.items()} if mirrored else x)
    sides = [
        (
            min(at - node.left for node, at in x.items()),
            max(at + node.right for node, at in x.items()),
        )
        for x in found
    ]
    # All are aligned with the narrowest, by the sides to which they were pushed.
    left, right = min(sides, key=lambda side: side[1] - side[0])
    shifts = [right - side[1] if i % 2 else left - side[0] for i, side in enumerate(sides)]
    for layer in layers:
        for node in layer:
            _, a, b, _ = sorted(x[node] + shift for x, shift in zip(found, shifts, strict=True))
            node.x = round((a + b) / 2, 1)


def _crossed(layers: Layers) -> set[Link]:
    """Find the links at boxes that cross a link within lines: the lines must stay straight."""
    position = {node: i for layer in layers for i, node in enumerate(layer)}
    crossed = set()
    for layer in layers:
        links = [link for node in layer for link in node.below]
        inner = [
            (position[link.upper], position[link.lower])
            for link in links
            if not link.upper.spread and not link.lower.spread
        ]
        for link in links:
            if link.upper.spread or link.lower.spread:
                upper, lower = position[link.upper], position[link.lower]
                if any((upper - a) * (lower - b) < 0 for a, b in inner):
                    crossed.add(link)
    return crossed


def _blocks(layers: Layers, upward: bool, crossed: set[Link]) -> dict[Node, Node]:
    """Align nodes with one in the layer before, and return the first node of each one's block."""
    position = {node: i for layer in layers for i, node in enumerate(layer)}
    block = {node: node for node in position}
    for layer in layers:
        last = -1
        for node in layer:
            near = [
                (position[other], other)
                for link in (node.below if upward else node.above)
                if link not in crossed
                for other in (link.lower if upward else link.upper,)
            ]
            if len(near) > 1:
                near.sort(key=_at)
            for middle in range((len(near) - 1) // 2, len(near) // 2 + 1) if near else ():
                at, other = near[middle]
                if at > last:
                    block[node] = block[other]
                    last = at
                    break
    return block


def _compact(layers: Layers, block: dict[Node, Node], mirrored: bool) -> dict[Node, float]:
    """Push blocks to the left as far as their nodes' room allows, then back towards their kin."""
    after: dict[Node, dict[Node, float]] = {first: {} for first in block.values()}
    waiting = dict.fromkeys(after, 0)
    for layer in layers:
        for a, b in pairwise(layer):
            room = (a.left if mirrored else a.right) + _GAP + (b.right if mirrored else b.left)
            here, there = block[a], block[b]
            if there not in after[here]:
                waiting[there] += 1
            after[here][there] = max(room, after[here].get(there, 0))
    x = dict.fromkeys(after, 0.0)
    order = [first for first, count in waiting.items() if not count]
    for here in order:  # which grows meanwhile: a topological order of the blocks
        for there, room in after[here].items():
            x[there] = max(x[there], x[here] + room)
            waiting[there] -= 1
            if not waiting[there]:
                order.append(there)
    for here in reversed(order):
        if after[here]:
            x[here] = min(x[there] - room for there, room in after[here].items())
    return {node: x[first] for node, first in block.items()}


def _spread_links(node: Node) -> None:
    """Let links end as nearly above or below their other ends as the node's width allows."""
    below = sorted(node.below, key=lambda link: link.lower.x)
    above = sorted(node.above, key=lambda link: link.upper.x)
    starts = _ends([link.lower.x - node.x for link in below], node.spread)
    ends = _ends([link.upper.x - node.x for link in above], node.spread)
    for link, at in zip(below, starts, strict=True):
        link.start = at
    for link, at in zip(above, ends, strict=True):
        link.end = at


def _ends(wishes: list[float], spread: float) -> list[float]:
    gap = min(_ENDS, spread / max(len(wishes) - 1, 1))
    return [round(at, 1) for at in spread_apart(wishes, gap, spread / 2)]


def spread_apart(wishes: Sequence[float], gap: float, limit: float) -> list[float]:
    """Find places near to `wishes`, in their order, `gap` apart, within `limit` of 0.

    This is least squares under an order, solved exactly by pooling neighbours that want to pass
    each other.
    """
    pools: list[tuple[float, int]] = []  # mean and size
    for i, wish in enumerate(wishes):
        mean, size = wish - i * gap, 1
        while pools and pools[-1][0] > mean:
            other, other_size = pools.pop()
            mean = (mean * size + other * other_size) / (size + other_size)
            size += other_size
        pools.append((mean, size))
    highest = limit - (len(wishes) - 1) * gap
    means = [min(max(mean, -limit), highest) for mean, size in pools for _ in range(size)]
    return [mean + i * gap for i, mean in enumerate(means)]


def _set_rows(layers: Layers) -> list[tuple[float, float]]:
    bands, y = [], 0.0
    for layer in layers:
        height = max((node.height for node in layer), default=0)
        for node in layer:
            node.y = y + height / 2
        bands.append((y, y + height))
        aside = [
            abs(link.upper.x + link.start - link.lower.x - link.end)
            for node in layer
            for link in node.below
        ]
        y += height + _LAYER_GAP + min(_SLOPE * max(aside, default=0), _MOST)
    return bands
