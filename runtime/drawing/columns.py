"""Where the nodes of ordered layers stand from left to right, so that long lines run straight.

The method of Brandes and Köpf (2001): nodes are aligned with a median neighbour into blocks, the
blocks pushed together, once for each of the four corners, and the four results balanced.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from operator import itemgetter

from .layered_graph import LayerNode, Layers, Link

__all__ = ["set_columns", "spread_apart"]

_GAP = 20.0  # between neighbours in a layer

_at = itemgetter(0)


def set_columns(layers: Layers) -> None:
    """Set the x of all nodes."""
    crossed = _crossed(layers)
    found: list[dict[LayerNode, float]] = []
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
    left, right = min(sides, key=lambda side: side[1] - side[0])
    shifts = [right - side[1] if i % 2 else left - side[0] for i, side in enumerate(sides)]
    for layer in layers:
        for node in layer:
            _, a, b, _ = sorted(x[node] + shift for x, shift in zip(found, shifts, strict=True))
            node.x = round((a + b) / 2, 1)


def _crossed(layers: Layers) -> set[Link]:
    """Return the links at boxes that cross a link between none, which must stay straight."""
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


def _blocks(layers: Layers, upward: bool, crossed: set[Link]) -> dict[LayerNode, LayerNode]:
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


def _compact(
    layers: Layers, block: dict[LayerNode, LayerNode], mirrored: bool
) -> dict[LayerNode, float]:
    """Push blocks to the left as far as their nodes' room allows, then back towards their kin."""
    after: dict[LayerNode, dict[LayerNode, float]] = {first: {} for first in block.values()}
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
    for here in order:
        for there, room in after[here].items():
            x[there] = max(x[there], x[here] + room)
            waiting[there] -= 1
            if not waiting[there]:
                order.append(there)
    for here in reversed(order):
        if after[here]:
            x[here] = min(x[there] - room for there, room in after[here].items())
    return {node: x[first] for node, first in block.items()}


def spread_apart(wishes: Sequence[float], gap: float, limit: float) -> list[float]:
    """Return places near to `wishes`, in their order, `gap` apart, within `limit` of 0.

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
