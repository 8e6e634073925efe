"""A machine in layers from its initial state down, its labels standing in layers of their own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from .curves import through
from .diagram import Arrow, Box, Edge
from .layered_graph import Arc, LayerNode, Link, back_arcs, ranks
from .loops import loop_room, self_loops
from .ordering import place
from .shapes import Curve, PicturePoint

__all__ = ["automatic_layout"]

_THIN = 5.0  # half the room for a line that passes a layer
_PORT_GAP = 12.0  # the least distance of two arrows at a box
_STUB = 12.0  # of an arrow that is straight, above and below a box
_CORNERS = 24.0  # of a box's width, where no arrows are


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
        nodes.append(LayerNode(at - min(rank), box.width / 2, right, height, spread))
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
    """Return a box with room for the ends of all its arrows."""
    ends = max(sum(upper == i for upper, _ in down), sum(lower == i for _, lower in down))
    return replace(
        box,
        width=max(box.width, _CORNERS + _PORT_GAP * (ends - 1)),
        height=max(box.height, loop_room([arrow.label for arrow in loops])[1]),
    )


def _chain(
    nodes: list[LayerNode], upper: LayerNode, lower: LayerNode, arrow: Arrow, backwards: bool
) -> tuple[list[Link], LayerNode]:
    """Join two nodes through every layer between; return the links and the label's node.

    The label is next to the source, where one asks which transition fires.
    """
    label_rank = lower.rank - 1 if backwards else upper.rank + 1
    links: list[Link] = []
    here = written = upper
    for rank in range(upper.rank + 1, lower.rank):
        if rank == label_rank:
            half = arrow.label.width / 2
            after = written = LayerNode(rank, half, half, arrow.label.height)
        else:
            after = LayerNode(rank, _THIN, _THIN, 0)
        nodes.append(after)
        links.append(Link(here, after))
        here = after
    links.append(Link(here, lower))
    return links, written


def _route(
    links: Sequence[Link], bands: Sequence[tuple[float, float]], start: float, end: float
) -> Curve:
    """Return the curve along links: it crosses layers vertically, and bends between them."""
    first, last = links[0], links[-1]
    x = first.upper.x + first.start
    points = [PicturePoint(x, start), PicturePoint(x, bands[first.upper.rank][1])]
    for link in links[:-1]:
        top, bottom = bands[link.lower.rank]
        points += PicturePoint(link.lower.x, top), PicturePoint(link.lower.x, bottom)
    x = last.lower.x + last.end
    points += PicturePoint(x, bands[last.lower.rank][0]), PicturePoint(x, end)
    return through(points)
