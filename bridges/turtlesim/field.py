"""A picture of the field: background, trails, turtles with their names, a caption if wanted.

    draw(simulator, "field.svg", caption="Wanderer after a minute")

The field fills 500 x 500 units, one to a pixel of turtlesim's window; a caption stands below it.
"""

import os
from collections.abc import Callable, Iterator
from math import cos, degrees, pi, sin
from pathlib import Path
from textwrap import wrap
from typing import Final, NamedTuple
from uuid import uuid4

from .arithmetic import FIELD, METER
from .canvas import SIZE
from .errors import PictureFormatError
from .pen import Color
from .png import to_png
from .shapes import Drawing, Ellipse, Group, Label, Line, Polygon, Shape
from .simulator import Simulator
from .svg import to_svg
from .turtle import Turtle

__all__ = ["draw", "drawing"]

_WRITERS: Final[dict[str, Callable[[Drawing], bytes]]] = {".svg": to_svg, ".png": to_png}

_WHITE: Final = Color(255, 255, 255)
_INK: Final = Color(30, 36, 64)

_CAPTION_CHARACTERS = 56  # in a line of the caption
_CAPTION_SIZE = 14.0
_CAPTION_LEADING = 20.0
_NAME_SIZE = 13.0


class _Coat(NamedTuple):
    """A turtle's colours: the shell's rim, its plates, the skin."""

    rim: Color
    plate: Color
    skin: Color


_COATS: Final = (
    _Coat(Color(27, 94, 52), Color(76, 175, 96), Color(174, 213, 129)),  # green
    _Coat(Color(166, 66, 20), Color(245, 144, 60), Color(255, 213, 145)),  # orange
    _Coat(Color(136, 20, 79), Color(232, 92, 152), Color(250, 187, 212)),  # pink
    _Coat(Color(0, 96, 100), Color(46, 184, 190), Color(160, 226, 222)),  # teal
    _Coat(Color(140, 98, 0), Color(246, 201, 62), Color(255, 238, 165)),  # yellow
    _Coat(Color(130, 24, 24), Color(229, 83, 75), Color(255, 190, 172)),  # red
)


def draw(simulator: Simulator, path: str | os.PathLike[str], caption: str = "") -> tuple[Path, ...]:
    """Draw the field into `path`, or without an ending into .svg and .png; return what it wrote.

    Folders that are missing are made. A file is complete at every moment, also for those who read
    it while it is replaced. Raise PictureFormatError for an ending that is neither .svg nor .png,
    PillowMissingError for a PNG without Pillow, and OSError where a file cannot be written.
    """
    path = Path(path)
    if not path.name:
        raise PictureFormatError(f"cannot draw {path}: it names a folder, not a file")
    if not path.suffix:
        paths: tuple[Path, ...] = (path.with_suffix(".svg"), path.with_suffix(".png"))
    elif path.suffix.lower() in _WRITERS:
        paths = (path,)
    else:
        raise PictureFormatError(
            f"cannot draw {path}: its ending is {path.suffix!r}, and must be .svg or .png, "
            "or left out for both"
        )
    picture = drawing(simulator, caption)
    path.parent.mkdir(parents=True, exist_ok=True)
    for file in paths:
        _replace(file, _WRITERS[file.suffix.lower()](picture))
    return paths


def _replace(path: Path, content: bytes) -> None:
    """Write a file beside `path` and put it in its place in one move."""
    unfinished = path.with_name(f".{path.name}.{uuid4().hex}")
    try:
        unfinished.write_bytes(content)
        os.replace(unfinished, path)
    finally:
        unfinished.unlink(missing_ok=True)


def drawing(simulator: Simulator, caption: str = "") -> Drawing:
    """Return the field as shapes, with a caption below it if there is one."""
    background = simulator.parameters.background
    shapes: list[Shape] = [
        Line(stroke.points, stroke.pen.color, stroke.pen.width)
        for stroke in simulator.canvas.strokes
    ]
    turtles = list(simulator.turtles.values())
    shapes += [_turtle(turtle) for turtle in turtles]
    shapes += [_name(turtle, _shade(background, 0.55)) for turtle in turtles]
    lines = wrap(caption, _CAPTION_CHARACTERS)
    band = _CAPTION_LEADING * (len(lines) + 1) if lines else 0.0
    shapes += _caption(lines, band)
    names = ", ".join(simulator.turtles) or "no turtle"
    return Drawing(caption.strip() or f"turtlesim: {names}", SIZE, SIZE + band, background, shapes)


def _caption(lines: list[str], band: float) -> Iterator[Shape]:
    if lines:
        corners = ((0, SIZE), (SIZE, SIZE), (SIZE, SIZE + band), (0, SIZE + band))
        yield Polygon(corners, _WHITE)
    for number, line in enumerate(lines, start=1):
        baseline = SIZE + _CAPTION_LEADING * number + _CAPTION_SIZE / 3
        yield Label(SIZE / 2, baseline, line, _CAPTION_SIZE, _INK)


def _name(turtle: Turtle, rim: Color) -> Shape:
    """Write the name below its turtle, or above it near the lower edge, inside the field."""
    x, y = _position(turtle)
    margin = min(_NAME_SIZE * 0.3 * len(turtle.name) + 4.0, SIZE / 2)
    baseline = y + 38.0 if y < SIZE - 44.0 else y - 28.0
    x = min(max(x, margin), SIZE - margin)
    return Label(x, baseline, turtle.name, _NAME_SIZE, _WHITE, rim)


def _position(turtle: Turtle) -> tuple[float, float]:
    """Return where a turtle is; one just spawned outside is where its first step will put it."""
    x, y = turtle.pose.x, FIELD - turtle.pose.y
    return min(max(x, 0.0), FIELD) * METER, min(max(y, 0.0), FIELD) * METER


def _shade(color: Color, part: float) -> Color:
    return Color(*(round(value * part) for value in color))


def _turtle(turtle: Turtle) -> Shape:
    """Draw a turtle as big as turtlesim's, 45 units, seen from above and facing its heading."""
    x, y = _position(turtle)
    coat = _COATS[(sum(turtle.name.encode()) - sum(b"turtle1")) % len(_COATS)]
    return Group(x, y, -degrees(turtle.pose.theta), tuple(_body(coat)))


def _body(coat: _Coat) -> Iterator[Shape]:
    """Draw a turtle that faces right, about the origin."""
    yield Polygon(((-14.0, -3.5), (-23.0, 0.0), (-14.0, 3.5)), coat.skin)
    for side in (-1.0, 1.0):
        yield Ellipse(9.5, side * 13.0, 8.0, 4.0, coat.skin, side * 50.0)
        yield Ellipse(-10.0, side * 12.0, 7.0, 3.5, coat.skin, side * -50.0)
    yield Ellipse(17.5, 0.0, 6.5, 5.0, coat.skin)
    for side in (-1.0, 1.0):
        yield Ellipse(20.0, side * 2.8, 1.3, 1.3, _INK)
    yield Ellipse(0.0, 0.0, 16.0, 13.5, coat.rim)
    yield Ellipse(0.0, 0.0, 14.0, 11.5, coat.plate)
    plate = [(7.0 * cos(k * pi / 3), 6.0 * sin(k * pi / 3)) for k in range(6)]
    for px, py in plate:
        yield Line(((px, py), (px * 2, py * 1.92)), coat.rim, 1.5)
    yield Line((*plate, plate[0]), coat.rim, 1.5)
