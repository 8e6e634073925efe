"""Shapes as PNG, with Pillow: twice the drawing's size, smoothed from six times."""

from collections.abc import Callable, Iterable
from functools import lru_cache
from io import BytesIO
from math import cos, pi, radians, sin
from typing import TYPE_CHECKING

from .errors import PillowMissingError
from .pen import Color
from .shapes import Drawing, Ellipse, Group, Label, Line, Point, Polygon, Shape

if TYPE_CHECKING:
    from PIL.ImageDraw import ImageDraw
    from PIL.ImageFont import FreeTypeFont, ImageFont

__all__ = ["SCALE", "to_png"]

SCALE = 2
"""Pixels of the picture for a unit of the drawing."""

_SMOOTH = 3  # Pillow draws hard edges: draw larger and average
_CORNERS = 48  # of the polygon that stands for an ellipse

_Place = Callable[[Point], Point]


def to_png(drawing: Drawing) -> bytes:
    """Return a drawing as a PNG file; raise PillowMissingError without Pillow."""
    try:
        from PIL import Image, ImageDraw
    except ImportError as error:
        raise PillowMissingError(
            "drawing a PNG needs Pillow: pip install 'llfsm[draw]', or draw an SVG"
        ) from error
    unit = SCALE * _SMOOTH
    size = round(drawing.width * unit), round(drawing.height * unit)
    image = Image.new("RGB", size, drawing.background)
    _paint(ImageDraw.Draw(image), drawing.shapes, lambda p: (p[0] * unit, p[1] * unit), unit)
    file = BytesIO()
    image.reduce(_SMOOTH).save(file, "PNG", optimize=True)
    return file.getvalue()


def _paint(draw: "ImageDraw", shapes: Iterable[Shape], place: _Place, unit: float) -> None:
    """Paint shapes whose points `place` maps to pixels, `unit` pixels to the unit."""
    for shape in shapes:
        match shape:
            case Line(points, color, width):
                _line(draw, [place(point) for point in points], color, width * unit)
            case Polygon(points, fill):
                draw.polygon([place(point) for point in points], fill)
            case Ellipse(x, y, rx, ry, fill, turn):
                within = _placed(place, x, y, turn)
                angles = (2 * pi * corner / _CORNERS for corner in range(_CORNERS))
                draw.polygon([within((rx * cos(a), ry * sin(a))) for a in angles], fill)
            case Label(x, y, text, size, color, rim):
                draw.text(
                    place((x, y)),
                    text,
                    fill=color,
                    font=_font(size * unit),
                    anchor="ms",
                    stroke_width=round(size / 8 * unit) if rim else 0,
                    stroke_fill=rim,
                )
            case Group(x, y, turn, members):
                _paint(draw, members, _placed(place, x, y, turn), unit)


def _placed(place: _Place, x: float, y: float, turn: float) -> _Place:
    """Return the place of points whose origin is moved to (x, y) and turned about it."""
    c, s = cos(radians(turn)), sin(radians(turn))
    return lambda p: place((x + c * p[0] - s * p[1], y + s * p[0] + c * p[1]))


def _line(draw: "ImageDraw", points: list[Point], color: Color, width: float) -> None:
    draw.line(points, color, round(width), joint="curve")
    radius = width / 2
    for x, y in (points[0], points[-1]):
        draw.ellipse((x - radius, y - radius, x + radius, y + radius), color)


@lru_cache(maxsize=8)
def _font(size: float) -> "FreeTypeFont | ImageFont":
    from PIL import ImageFont

    return ImageFont.load_default(size)
