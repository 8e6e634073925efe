"""A diagram as PNG, with Pillow: twice the diagram's size, drawn larger and smoothed."""

from __future__ import annotations

from collections.abc import Iterable
from functools import lru_cache
from io import BytesIO
from itertools import pairwise
from math import ceil, hypot
from typing import TYPE_CHECKING, TypeAlias

from ..engine.errors import DrawingError
from . import style
from .curves import sample
from .diagram import Box, Curve, Diagram, Label, Point, arrow_head
from .typeset import TextLine, box_lines, label_lines

if TYPE_CHECKING:
    from PIL.ImageDraw import ImageDraw
    from PIL.ImageFont import FreeTypeFont, ImageFont

    Font: TypeAlias = FreeTypeFont | ImageFont

__all__ = ["to_png"]

_SCALE = 2  # pixels for a unit of the diagram
_SMOOTH = (3, 2, 1)  # Pillow draws hard edges: draw so many times larger, then average
_PIXELS = 80_000_000  # that Pillow may draw on: 240 MB
_SANS = ("DejaVuSans.ttf", "LiberationSans-Regular.ttf", "Arial Unicode.ttf", "arial.ttf")
_MONOSPACED = ("DejaVuSansMono.ttf", "LiberationMono-Regular.ttf", "Menlo.ttc", "consola.ttf")


def to_png(diagram: Diagram) -> bytes:
    """Return a diagram as a PNG file.

    Raise `DrawingError` without Pillow, or for a picture too large to draw.
    """
    try:
        from PIL import Image, ImageDraw
    except ImportError as error:
        raise DrawingError(
            "drawing a PNG needs Pillow: pip install 'llfsm[draw]', or draw an SVG"
        ) from error
    area = diagram.width * diagram.height * _SCALE**2
    smooth = next((s for s in _SMOOTH if area * s * s <= _PIXELS), None)
    if smooth is None:
        raise DrawingError(
            f"a PNG of {diagram.width:.0f} by {diagram.height:.0f} would be too large: draw an SVG"
        )
    unit = _SCALE * smooth
    size = ceil(diagram.width * _SCALE) * smooth, ceil(diagram.height * _SCALE) * smooth
    image = Image.new("RGB", size, style.BACKGROUND)
    _Painter(ImageDraw.Draw(image), diagram.left, diagram.top, unit).paint(diagram)
    file = BytesIO()
    image.reduce(smooth).save(file, "PNG", optimize=True)
    return file.getvalue()


class _Painter:
    """Paint what a diagram is made of, `unit` pixels to its unit."""

    def __init__(self, draw: ImageDraw, left: float, top: float, unit: int):
        self.draw = draw
        self.left = left
        self.top = top
        self.unit = unit

    def paint(self, diagram: Diagram) -> None:
        dot = diagram.start[0]
        rim = (Point(dot.x + dx, dot.y + dx) for dx in (-style.DOT, style.DOT))
        self.draw.ellipse([self.at(p) for p in rim], style.INK)
        self.arrow(diagram.start, style.INK)
        for edge in diagram.edges:
            self.arrow(edge.curve, style.EDGE)
        for box in diagram.boxes:
            self.box(box)
        for edge in diagram.edges:
            self.label(edge.label)

    def at(self, point: Point) -> tuple[float, float]:
        return (point.x - self.left) * self.unit, (point.y - self.top) * self.unit

    def arrow(self, curve: Curve, color: str) -> None:
        pieces = (len(curve) - 1) // 3
        self.line(sample(curve, 20 * pieces), color)
        self.draw.polygon([self.at(point) for point in arrow_head(curve)], color)

    def line(self, points: Iterable[Point], color: str) -> None:
        width = round(style.LINE * self.unit)
        self.draw.line([self.at(point) for point in points], color, width, joint="curve")

    def box(self, box: Box) -> None:
        unit = self.unit
        for inset in (0, style.RIM) if box.accepting else (0,):
            corners = (
                Point(box.left + inset, box.top + inset),
                Point(box.right - inset, box.bottom - inset),
            )
            self.draw.rounded_rectangle(
                [self.at(point) for point in corners],
                (style.CORNER - inset / 2) * unit,
                style.FILL,
                None if box.suspend else style.BORDER,
                round(style.LINE * unit),
            )
            if box.suspend:
                for dash in _dashes(_outline(box, inset)):
                    self.line(dash, style.BORDER)
        self.text(box_lines(box))

    def label(self, label: Label) -> None:
        x, y = label.width / 2, label.height / 2
        corners = Point(label.x - x, label.y - y), Point(label.x + x, label.y + y)
        self.draw.rectangle([self.at(point) for point in corners], style.BACKGROUND)
        self.text(label_lines(label))

    def text(self, lines: Iterable[TextLine]) -> None:
        for line in lines:
            self.draw.text(
                self.at(Point(line.x, line.y)),
                _printable(line.text),
                fill=line.color,
                font=_font(_face(line), line.size * self.unit),
                anchor="ms" if line.centred else "ls",
                stroke_width=round(0.02 * line.size * self.unit) if line.face == "bold" else 0,
            )


def _face(line: TextLine) -> tuple[str, ...]:
    """Return the system's fonts to look for, where Pillow's own lacks characters or width."""
    if line.face == "code":
        return _MONOSPACED
    return () if line.text.isascii() else _SANS


@lru_cache(maxsize=8)
def _printable(text: str) -> str:
    """Return the text with a mark for what is no character to see: some layouts choke on it."""
    return "".join(char if char.isprintable() else "\N{REPLACEMENT CHARACTER}" for char in text)


def _font(names: tuple[str, ...], size: float) -> Font:
    from PIL import ImageFont

    for name in names:
        try:
            return ImageFont.truetype(name, size)
        except OSError:
            continue
    return ImageFont.load_default(size)


def _outline(box: Box, inset: float) -> list[Point]:
    """Return the points around a box with round corners."""
    corner = style.CORNER - inset / 2
    left, right, top, bottom = (
        box.left + inset, box.right - inset, box.top + inset, box.bottom - inset
    )  # fmt: skip
    arc = 0.45 * corner  # from the corner to the control points of a quarter of a circle
    points = []
    for x, y, dx, dy in (
        (right, top, -1, 1), (right, bottom, -1, -1), (left, bottom, 1, -1), (left, top, 1, 1)
    ):  # fmt: skip
        side, end = Point(x + dx * corner, y), Point(x, y + dy * corner)
        quarter = (side, Point(x + dx * arc, y), Point(x, y + dy * arc), end)
        points += sample(quarter if dx * dy < 0 else quarter[::-1], 8)
    return [*points, points[0]]


def _dashes(points: Iterable[Point]) -> Iterable[list[Point]]:
    """Cut a line into dashes."""
    on, gap = style.DASH
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
