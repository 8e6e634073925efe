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

from llfsm.bridges.turtlesim.canvas import SIZE, Rgb
from llfsm.bridges.turtlesim.errors import TurtlesimError
from llfsm.bridges.turtlesim.simulator import Simulator
from llfsm.bridges.turtlesim.turtle import FIELD, METER, Turtle
from llfsm.runtime.drawing.png import write_png
from llfsm.runtime.drawing.shapes import Ellipse, Group, Line, Picture, Polygon, Shape, Text
from llfsm.runtime.drawing.svg import write_svg

_WRITERS: Final[dict[str, Callable[[Picture], bytes]]] = {
    ".svg": lambda picture: write_svg(picture).encode(),
    ".png": write_png,
}

_WHITE: Final = "#ffffff"
_INK: Final = "#1e2440"

_CAPTION_CHARACTERS = 56  # in a line of the caption
_CAPTION_SIZE = 14.0
_CAPTION_LEADING = 20.0
_NAME_SIZE = 13.0


class _Coat(NamedTuple):
    """A turtle's colours: the shell's rim, its plates, the skin."""

    rim: str
    plate: str
    skin: str


_COATS: Final = (
    _Coat("#1b5e34", "#4caf60", "#aed581"),  # green
    _Coat("#a64214", "#f5903c", "#ffd591"),  # orange
    _Coat("#88144f", "#e85c98", "#fabbd4"),  # pink
    _Coat("#006064", "#2eb8be", "#a0e2de"),  # teal
    _Coat("#8c6200", "#f6c93e", "#ffeea5"),  # yellow
    _Coat("#821818", "#e5534b", "#ffbeac"),  # red
)


def draw(simulator: Simulator, path: str | os.PathLike[str], caption: str = "") -> tuple[Path, ...]:
    """Draw the field into `path`, or without an ending into .svg and .png; return the files.

    Missing folders are created. Files are replaced atomically. Raise `TurtlesimError` for an
    ending that is neither .svg nor .png, `DrawingError` for a PNG without Pillow, and `OSError` if
    a file cannot be written.
    """
    path = Path(path)
    if not path.name:
        raise TurtlesimError(f"cannot draw {path}: it names a folder, not a file")
    if not path.suffix:
        paths: tuple[Path, ...] = (path.with_suffix(".svg"), path.with_suffix(".png"))
    elif path.suffix.lower() in _WRITERS:
        paths = (path,)
    else:
        raise TurtlesimError(
            f"cannot draw {path}: its ending is {path.suffix!r}, and must be .svg or .png, "
            "or left out for both"
        )
    picture = field_picture(simulator, caption)
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


def field_picture(simulator: Simulator, caption: str = "") -> Picture:
    """Make a picture of the field, with a caption below it if there is one."""
    background = simulator.parameters.background
    shapes: list[Shape] = [
        Line(stroke.points, stroke.pen.color.hex, stroke.pen.width)
        for stroke in simulator.canvas.strokes
    ]
    turtles = list(simulator.turtles.values())
    shapes += [_turtle(turtle) for turtle in turtles]
    shapes += [_name(turtle, _shade(background, 0.55)) for turtle in turtles]
    lines = wrap(caption, _CAPTION_CHARACTERS)
    band = _CAPTION_LEADING * (len(lines) + 1) if lines else 0.0
    shapes += _caption(lines, band)
    names = ", ".join(simulator.turtles) or "no turtle"
    title = caption.strip() or f"turtlesim: {names}"
    return Picture(title, SIZE, SIZE + band, background.hex, shapes)


def _caption(lines: list[str], band: float) -> Iterator[Shape]:
    if lines:
        corners = ((0, SIZE), (SIZE, SIZE), (SIZE, SIZE + band), (0, SIZE + band))
        yield Polygon(corners, _WHITE)
    for number, line in enumerate(lines, start=1):
        baseline = SIZE + _CAPTION_LEADING * number + _CAPTION_SIZE / 3
        yield Text(SIZE / 2, baseline, line, _CAPTION_SIZE, _INK)


def _name(turtle: Turtle, rim: str) -> Shape:
    """Write the name below its turtle, or above it near the lower edge, inside the field."""
    x, y = _position(turtle)
    margin = min(_NAME_SIZE * 0.3 * len(turtle.name) + 4.0, SIZE / 2)
    baseline = y + 38.0 if y < SIZE - 44.0 else y - 28.0
    x = min(max(x, margin), SIZE - margin)
    return Text(x, baseline, turtle.name, _NAME_SIZE, _WHITE, rim=rim)


def _position(turtle: Turtle) -> tuple[float, float]:
    """Return the place of a turtle; if just spawned outside, where its first step will put it."""
    x, y = turtle.pose.x, FIELD - turtle.pose.y
    return min(max(x, 0.0), FIELD) * METER, min(max(y, 0.0), FIELD) * METER


def _shade(color: Rgb, part: float) -> str:
    return Rgb(*(round(value * part) for value in color)).hex


def _turtle(turtle: Turtle) -> Shape:
    """Draw a turtle as big as turtlesim's, 45 units, seen from above and facing its heading."""
    x, y = _position(turtle)
    coat = _COATS[(sum(turtle.name.encode()) - sum(b"turtle1")) % len(_COATS)]
    return Group(tuple(_body(coat)), x, y, -degrees(turtle.pose.theta))


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
