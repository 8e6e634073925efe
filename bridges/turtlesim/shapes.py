"""What a picture is made of, whatever it is drawn with: a few flat shapes, back to front.

Lengths are in units of the drawing, x to the right and y down. Angles are in degrees, from x
towards y, so clockwise as one sees it. Colours are opaque.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from .pen import Color

__all__ = ["Drawing", "Ellipse", "Group", "Label", "Line", "Point", "Polygon", "Shape"]

Point = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Line:
    """A polyline with round ends and joints."""

    points: Sequence[Point]
    color: Color
    width: float


@dataclass(frozen=True, slots=True)
class Polygon:
    """A filled polygon."""

    points: Sequence[Point]
    fill: Color


@dataclass(frozen=True, slots=True)
class Ellipse:
    """A filled ellipse with half axes rx and ry, turned about its centre."""

    x: float
    y: float
    rx: float
    ry: float
    fill: Color
    turn: float = 0.0


@dataclass(frozen=True, slots=True)
class Label:
    """A line of text with its baseline's middle at (x, y); a rim sets it off from its ground."""

    x: float
    y: float
    text: str
    size: float
    color: Color
    rim: Color | None = None


@dataclass(frozen=True, slots=True)
class Group:
    """Shapes with an origin of their own: moved to (x, y) and turned about it."""

    x: float
    y: float
    turn: float
    shapes: Sequence["Shape"]


Shape = Line | Polygon | Ellipse | Label | Group


@dataclass(frozen=True, slots=True)
class Drawing:
    """A picture of some width and height, with a title for those who cannot see it."""

    title: str
    width: float
    height: float
    background: Color
    shapes: Sequence[Shape]
