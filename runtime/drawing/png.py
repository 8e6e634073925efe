"""Pictures as PNG, with Pillow: twice the picture's size.

Pillow draws without anti-aliasing, so the picture is drawn up to three times larger than that and
averaged; a picture for which that takes too much memory is drawn less large.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import lru_cache
from io import BytesIO
from itertools import pairwise
from math import ceil, cos, hypot, pi, radians, sin
from typing import TYPE_CHECKING, TypeAlias

from llfsm.runtime.drawing import shapes
from llfsm.runtime.drawing.curves import Point, sample
from llfsm.runtime.engine.errors import DrawingError

if TYPE_CHECKING:
    from PIL.ImageDraw import ImageDraw
    from PIL.ImageFont import FreeTypeFont, ImageFont


SCALE = 2
"""Pixels for a unit of the picture; one for a picture so large that two take too much memory."""

_SIZES = ((SCALE, 3), (SCALE, 2), (SCALE, 1), (1, 1))  # scale, and how much larger it is drawn
_PIXELS = 80_000_000  # that Pillow may draw on: 240 MB
_CORNERS = 48  # of the polygon that stands for an ellipse
_ARC = 0.45  # from a round corner to the control points of its quarter of a circle, in radii
_SANS = ("DejaVuSans.ttf", "LiberationSans-Regular.ttf", "Arial Unicode.ttf", "arial.ttf")
_MONOSPACED = ("DejaVuSansMono.ttf", "LiberationMono-Regular.ttf", "Menlo.ttc", "consola.ttf")

_Place: TypeAlias = Callable[[tuple[float, float]], tuple[float, float]]


def write_png(picture: shapes.Picture) -> bytes:
    """Write a picture as a PNG file.

    Raise `DrawingError` without Pillow, or for a picture too large to draw.
    """
    try:
        from PIL import Image, ImageDraw
    except ImportError as error:
        raise DrawingError(
            "drawing a PNG needs Pillow: pip install 'llfsm[draw]', or draw an SVG"
        ) from error
    area = picture.width * picture.height
    fitting = (size for size in _SIZES if area * (size[0] * size[1]) ** 2 <= _PIXELS)
    scale, smooth = next(fitting, (0, 0))
    if not scale:
        raise DrawingError(
            f"a PNG of {picture.width:.0f} by {picture.height:.0f} would be too large: draw an SVG"
        )
    unit = scale * smooth
    size = ceil(picture.width * scale) * smooth, ceil(picture.height * scale) * smooth
    image = Image.new("RGB", size, picture.background)
    left, top = picture.left, picture.top
    painter = _Painter(ImageDraw.Draw(image), unit)
    painter.paint(picture.shapes, lambda p: ((p[0] - left) * unit, (p[1] - top) * unit))
    file = BytesIO()
    image.reduce(smooth).save(file, "PNG", optimize=True)
    return file.getvalue()


class _Painter:
    """Paint shapes, `unit` pixels to their unit."""

    def __init__(self, draw: ImageDraw, unit: float):
        self.draw = draw
        self.unit = unit

    def paint(self, drawn: Iterable[shapes.Shape], place: _Place) -> None:
        """Paint shapes whose points `place` maps to pixels."""
        for shape in drawn:
            match shape:
                case shapes.Line(points, color, width):
                    self.line(map(place, points), color, width)
                    self.ends([place(points[0]), place(points[-1])], color, width)
                case shapes.Path(curve, color, width):
                    points = sample(curve, 20 * ((len(curve) - 1) // 3))
                    self.line(map(place, points), color, width)
                case shapes.Polygon(points, fill):
                    self.draw.polygon([place(point) for point in points], fill)
                case shapes.Ellipse(x, y, rx, ry, fill, turn):
                    within = _within(place, x, y, turn)
                    angles = (2 * pi * corner / _CORNERS for corner in range(_CORNERS))
                    self.draw.polygon([within((rx * cos(a), ry * sin(a))) for a in angles], fill)
                case shapes.Rectangle():
                    self.rectangle(shape, place)
                case shapes.Text():
                    self.text(shape, place)
                case shapes.Group(members, x, y, turn):
                    self.paint(members, _within(place, x, y, turn))

    def line(self, points: Iterable[tuple[float, float]], color: str, width: float) -> None:
        self.draw.line(list(points), color, round(width * self.unit), joint="curve")

    def ends(self, points: Iterable[tuple[float, float]], color: str, width: float) -> None:
        radius = width * self.unit / 2
        for x, y in points:
            self.draw.ellipse((x - radius, y - radius, x + radius, y + radius), color)

    def rectangle(self, shape: shapes.Rectangle, place: _Place) -> None:
        outline = _outline(shape)
        self.draw.polygon([place(point) for point in outline], shape.fill)
        if shape.stroke is None:
            return
        dashes = [outline] if shape.dash is None else _dashes(outline, *shape.dash)
        for dash in dashes:
            self.line(map(place, dash), shape.stroke, shape.stroke_width)

    def text(self, shape: shapes.Text, place: _Place) -> None:
        stroke = 0.02 if shape.face == "bold" else 0.0
        if shape.rim is not None:
            stroke = 0.125
        self.draw.text(
            place((shape.x, shape.y)),
            "".join(each if each.isprintable() else "\N{REPLACEMENT CHARACTER}"
                    for each in shape.text),  # some text layouts choke on the others
            fill=shape.color,
            font=_font(_fonts_for(shape), shape.size * self.unit),
            anchor="ms" if shape.centred else "ls",
            stroke_width=round(stroke * shape.size * self.unit),
            stroke_fill=shape.rim,
        )  # fmt: skip


def _within(place: _Place, x: float, y: float, turn: float) -> _Place:
    """Place points whose origin is moved to (x, y) and turned about it by `turn` degrees."""
    c, s = cos(radians(turn)), sin(radians(turn))
    return lambda p: place((x + c * p[0] - s * p[1], y + s * p[0] + c * p[1]))


def _fonts_for(shape: shapes.Text) -> tuple[str, ...]:
    """List the system's fonts to look for, where Pillow's own lacks characters or width."""
    if shape.face == "code":
        return _MONOSPACED
    return () if shape.text.isascii() else _SANS


@lru_cache(maxsize=32)
def _font(names: tuple[str, ...], size: float) -> FreeTypeFont | ImageFont:
    """Load the first of these fonts that is installed, or Pillow's own: that takes milliseconds."""
    from PIL import ImageFont

    for name in names:
        try:
            return ImageFont.truetype(name, size)
        except OSError:
            continue
    return ImageFont.load_default(size)


def _outline(shape: shapes.Rectangle) -> list[Point]:
    """List the points around a rectangle with round corners, the first one again at the end."""
    corner = shape.corner
    left, right = shape.left, shape.left + shape.width
    top, bottom = shape.top, shape.top + shape.height
    points = []
    for x, y, dx, dy in (
        (right, top, -1, 1), (right, bottom, -1, -1), (left, bottom, 1, -1), (left, top, 1, 1)
    ):  # fmt: skip
        side, end = Point(x + dx * corner, y), Point(x, y + dy * corner)
        arc = _ARC * corner
        quarter = (side, Point(x + dx * arc, y), Point(x, y + dy * arc), end)
        points += sample(quarter if dx * dy < 0 else quarter[::-1], 8)
    return [*points, points[0]]


def _dashes(points: Sequence[Point], on: float, gap: float) -> Iterator[list[Point]]:
    """Cut a line into dashes."""
    dash: list[Point] = []
    walked = 0.0
    for a, b in pairwise(points):
        length, done = hypot(b.x - a.x, b.y - a.y), 0.0
        while done < length:
            phase = walked % (on + gap)
            step = min((on if phase < on else on + gap) - phase + 1e-6, length - done)
            here = Point(a.x + (b.x - a.x) * done / length, a.y + (b.y - a.y) * done / length)
            done += step
            walked += step
            if phase < on:
                there = Point(a.x + (b.x - a.x) * done / length, a.y + (b.y - a.y) * done / length)
                dash += [there] if dash else [here, there]
            elif dash:
                yield dash
                dash = []
    if dash:
        yield dash
