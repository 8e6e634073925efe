"""A drawn machine as data: boxes, curves and labels with their places, for any writer.

Lengths are in units of the picture, x to the right and y down. A curve ends at the tip of its
arrow.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import hypot
from typing import NamedTuple

from llfsm.runtime.drawing.shapes import Curve, PicturePoint

HEAD = 9.0
"""The length of an arrow's head."""


class SectionText(NamedTuple):
    """A section of a state and its source text; no lines if the source cannot be read."""

    name: str
    lines: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Box:
    """A state around its centre (x, y), with the sections that are shown.

    In an overview, it is a machine or, with `slot`, a slot.
    """

    state: str
    x: float
    y: float
    width: float
    height: float
    title: tuple[str, ...]
    sections: tuple[SectionText, ...] = ()
    initial: bool = False
    accepting: bool = False
    suspend: bool = False
    slot: bool = False

    @property
    def left(self) -> float:
        """Return the left side's x."""
        return self.x - self.width / 2

    @property
    def right(self) -> float:
        """Return the right side's x."""
        return self.x + self.width / 2

    @property
    def top(self) -> float:
        """Return the upper side's y."""
        return self.y - self.height / 2

    @property
    def bottom(self) -> float:
        """Return the lower side's y."""
        return self.y + self.height / 2


@dataclass(frozen=True, slots=True)
class Label:
    """Lines of text around their centre (x, y)."""

    x: float
    y: float
    width: float
    height: float
    lines: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Edge:
    """Transition `number` (from 0) of state `source`."""

    source: str
    number: int
    target: str
    curve: Curve
    label: Label


class Arrow(NamedTuple):
    """A transition to be drawn: source and target are places in the list of boxes."""

    source: int
    number: int
    target: int
    label: Label

    def edge(self, boxes: Sequence[Box], curve: Curve, label: Label) -> Edge:
        """Return it drawn along `curve` with its label in its place."""
        return Edge(boxes[self.source].state, self.number, boxes[self.target].state, curve, label)


@dataclass(frozen=True, slots=True)
class Diagram:
    """A machine's picture; (left, top) need not be (0, 0), for places that an editor chose.

    `start` is the arrow to the initial state; its first point is the centre of a dot. That of an
    overview is empty.
    """

    title: str
    left: float
    top: float
    width: float
    height: float
    boxes: tuple[Box, ...]
    edges: tuple[Edge, ...]
    start: Curve

    def _repr_svg_(self) -> str:
        """Return what a notebook shows."""
        from llfsm.runtime.drawing.rendering import to_svg

        return to_svg(self)


def arrow_head(curve: Curve) -> tuple[PicturePoint, PicturePoint, PicturePoint]:
    """Return the triangle at the end of a curve, its tip first."""
    tip = curve[-1]
    before = next((p for p in reversed(curve) if p != tip), PicturePoint(tip.x, tip.y - 1))
    length = hypot(tip.x - before.x, tip.y - before.y)
    dx, dy = (tip.x - before.x) / length, (tip.y - before.y) / length
    base = PicturePoint(tip.x - HEAD * dx, tip.y - HEAD * dy)
    side = HEAD * 0.38
    return (
        tip,
        PicturePoint(base.x - side * dy, base.y + side * dx),
        PicturePoint(base.x + side * dy, base.y - side * dx),
    )
