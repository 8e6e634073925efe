"""Nodes in layers: their order, chosen for few crossings, and their places.

The method of Sugiyama, Tagawa and Toda (1981): nodes stand in layers, links join neighbouring
layers only, and each layer is sorted by the barycentres of its nodes' neighbours.
"""

from __future__ import annotations

from bisect import bisect_right

from .columns import set_columns, spread_apart
from .layered_graph import LayerNode, Layers

__all__ = ["place"]

_GAP = 16.0  # between layers, more where links lead far to the side
_SLOPE = 0.1
_MOST = 40.0
_ENDS = 26.0  # between the ends of links at a node
_SORTINGS = 24


def place(nodes: list[LayerNode]) -> list[tuple[float, float]]:
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
    """Return how many links cross; those of one node do not cross each other."""
    crossings = sum(_inversions([place[other] for i in row for other in below[i]]) for row in rows)
    forks = [others for others in below if len(others) > 1]
    return crossings - sum(_inversions([place[other] for other in others]) for others in forks)


def _inversions(ends: list[int]) -> int:
    """Return how many pairs are not in order."""
    if ends == sorted(ends):
        return 0
    inversions = 0
    before: list[int] = []  # sorted
    for end in ends:
        at = bisect_right(before, end)
        inversions += len(before) - at
        before.insert(at, end)
    return inversions


def _spread_links(node: LayerNode) -> None:
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
        y += height + _GAP + min(_SLOPE * max(aside, default=0), _MOST)
    return bands
