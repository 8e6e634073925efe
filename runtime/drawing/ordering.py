"""Nodes in layers: their order, chosen for few crossings, and their places.

The method of Sugiyama, Tagawa and Toda (1981): nodes stand in layers, links join neighbouring
layers only, and each layer is sorted by the barycentres of its nodes' neighbours.
"""

from __future__ import annotations

from bisect import bisect_right, insort

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
    """Order each layer by the barycentres of its neighbours, keeping the best order seen."""
    best, fewest = [list(layer) for layer in layers], _crossings(layers)
    for turn in range(_SORTINGS):
        if not fewest:
            break
        down = turn % 2 == 0
        position = {node: float(i) for layer in layers for i, node in enumerate(layer)}
        for layer in layers if down else reversed(layers):
            for node in layer:
                near = [
                    position[link.upper if down else link.lower]
                    for link in (node.above if down else node.below)
                ]
                if near:
                    position[node] = sum(near) / len(near)
            layer.sort(key=position.__getitem__)
            position.update((node, float(i)) for i, node in enumerate(layer))
        crossings = _crossings(layers)
        if crossings < fewest:
            best, fewest = [list(layer) for layer in layers], crossings
    layers[:] = best


def _crossings(layers: Layers) -> int:
    position = {node: i for layer in layers for i, node in enumerate(layer)}
    crossings = 0
    for layer in layers:
        ends: list[int] = []
        for node in layer:
            mine = [position[link.lower] for link in node.below]
            crossings += sum(len(ends) - bisect_right(ends, end) for end in mine)
            for end in mine:
                insort(ends, end)
    return crossings


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
