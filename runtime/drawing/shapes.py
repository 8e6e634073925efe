"""Pictures: a few flat shapes, back to front, which `svg` and `png` write.

Lengths are in units of the picture, x to the right and y down. Angles are in degrees, clockwise.
Colours are opaque, as "#rrggbb".
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal, TypeAlias

from llfsm.runtime.drawing.curves import Curve


@dataclass(frozen=True, slots=True)
class Line:
    """A polyline with round ends and joints."""

    points: Sequence[tuple[float, float]]
    color: str
    width: float


@dataclass(frozen=True, slots=True)
class Path:
    """A curved line."""

    curve: Curve
    color: str
    width: float


@dataclass(frozen=True, slots=True)
class Polygon:
    """A filled polygon."""

    points: Sequence[tuple[float, float]]
    fill: str


@dataclass(frozen=True, slots=True)
class Ellipse:
    """A filled ellipse with half axes rx and ry, turned about its centre."""

    x: float
    y: float
    rx: float
    ry: float
    fill: str
    turn: float = 0.0


@dataclass(frozen=True, slots=True)
class Rectangle:
    """A filled rectangle with round corners and, if it has a `stroke`, a border.

    `dash` gives the lengths of the border's dashes and of the gaps between them.
    """

    left: float
    top: float
    width: float
    height: float
    corner: float
    fill: str
    stroke: str | None = None
    stroke_width: float = 0.0
    dash: tuple[float, float] | None = None


@dataclass(frozen=True, slots=True)
class Text:
    """A line of text with its baseline's start, or its middle if `centred`, at (x, y).

    A `rim` around the letters sets them off from their background.
    """

    x: float
    y: float
    text: str
    size: float
    color: str
    face: Literal["regular", "bold", "code"] = "regular"
    centred: bool = True
    rim: str | None = None


@dataclass(frozen=True, slots=True)
class Group:
    """Shapes with an origin of their own: moved to (x, y) and turned about it.

    `attributes` are written to an SVG, for style sheets and scripts.
    """

    shapes: Sequence[Shape]
    x: float = 0.0
    y: float = 0.0
    turn: float = 0.0
    attributes: Mapping[str, str] = field(default_factory=dict)


Shape: TypeAlias = Line | Path | Polygon | Ellipse | Rectangle | Text | Group


@dataclass(frozen=True, slots=True)
class Picture:
    """Shapes in a frame, with a title for screen readers."""

    title: str
    width: float
    height: float
    background: str
    shapes: Sequence[Shape]
    left: float = 0.0
    top: float = 0.0
