"""The graph that a layout places: nodes in layers, and links between neighbouring layers."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TypeAlias

__all__ = ["Layers", "Link", "Node"]


@dataclass(eq=False, slots=True)
class Node:
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

    upper: Node
    lower: Node
    start: float = 0.0
    end: float = 0.0

    def __post_init__(self) -> None:
        self.upper.below.append(self)
        self.lower.above.append(self)


Layers: TypeAlias = list[list[Node]]
