"""The field that pens draw on: pixels for the colour sensor, strokes for pictures.

Pixels. turtlesim's pens draw into a Qt image of 500 x 500 pixels, 45 to the metre, and the colour
sensor reads a pixel of it. Here a line is the rectangle around it that Qt's flat pen with square
ends covers, and a pixel is drawn if its centre lies in that rectangle. Qt first rounds the
rectangle to fractions of a pixel, so against Qt 5.15 some 4 pixels in 1000 differ, all at a line's
edge. Lines of a pen of width 1, which Qt draws by another algorithm, are often a pixel aside.

Strokes. At 62.5 points a second a trail must be thinned while it grows. A leg of a stroke runs from
its anchor to the latest point. Each point it has passed leaves a cone of slopes at which the leg
still runs within `TOLERANCE` of that point. A new point inside all those cones moves the leg's end;
one outside them, or one that turns back, is the end of a new leg. So a step costs the same however
long the trail has grown, and a straight run is one leg however long it took.
"""

from __future__ import annotations

from functools import lru_cache
from math import ceil, floor, hypot
from typing import NamedTuple

from llfsm.bridges.turtlesim.errors import TurtlesimError

SIZE = 500
"""Width and height in pixels; x runs right and y down from the upper left corner."""

_BYTES = 4  # of a pixel: red, green, blue, and 255 where something is drawn
_FLAT = 1e-9  # a direction's part so small is taken for this: the slopes below divide by it
_LOW, _HIGH = -300.0, SIZE + 300.0  # beyond, even the widest pen (255) leaves no mark
TOLERANCE = 0.05
"""Pixels that a point on the way may lie off the kept line: too little to see."""


class Rgb(NamedTuple):
    """An opaque colour, as in turtlesim/msg/Color; each part 0 to 255."""

    r: int
    g: int
    b: int

    @property
    def hex(self) -> str:
        """The colour as "#rrggbb"."""
        return "#{:02x}{:02x}{:02x}".format(*self)


class Pen(NamedTuple):
    """The pen of a turtle: a colour, and a width in pixels (1 to 255)."""

    color: Rgb = Rgb(0xB3, 0xB8, 0xFF)
    width: int = 3

    @classmethod
    def of(cls, r: int, g: int, b: int, width: int) -> Pen:
        """Make the pen that SetPen asks for; width 0 is 1, as Qt's default is."""
        for name, value in (("r", r), ("g", g), ("b", b), ("width", width)):
            if not 0 <= value <= 255:
                raise TurtlesimError(f"a pen's {name} is from 0 to 255, not {value}")
        return cls(Rgb(r, g, b), width or 1)


class Stroke:
    """Grow a polyline of points (x, y), in pixels, drawn by one turtle with one pen.

    `points` is at all times what to draw: its last point is the latest one.
    """

    __slots__ = ("_ahead", "_high", "_low", "_ux", "_uy", "pen", "points", "turtle")

    def __init__(self, turtle: str, pen: Pen, x0: float, y0: float, x1: float, y1: float) -> None:
        self.turtle = turtle
        self.pen = pen
        self.points = [(x0, y0)]
        self._ux = self._uy = self._ahead = self._low = self._high = 0.0
        self._bend(x1, y1)

    def prolong(self, x: float, y: float) -> bool:
        """Move the end of the last leg to (x, y), or return False if that would bend it."""
        x0, y0 = self.points[-2]
        dx, dy = x - x0, y - y0
        ahead = dx * self._ux + dy * self._uy
        if ahead <= self._ahead:
            return False
        aside = dy * self._ux - dx * self._uy
        if not self._low * ahead <= aside <= self._high * ahead:
            return False
        self.points[-1] = (x, y)
        self._ahead = ahead
        self._low = max(self._low, (aside - TOLERANCE) / ahead)
        self._high = min(self._high, (aside + TOLERANCE) / ahead)
        return True

    def extend(self, x: float, y: float) -> None:
        """Go on to (x, y), with a new leg where the way bends."""
        if not self.prolong(x, y):
            self._bend(x, y)

    def _bend(self, x: float, y: float) -> None:
        x0, y0 = self.points[-1]
        self.points.append((x, y))
        dx, dy = x - x0, y - y0
        length = hypot(dx, dy)
        # A leg without length is a dot: any longer leg from it is a new one.
        self._ux, self._uy = (dx / length, dy / length) if length else (0.0, 0.0)
        self._ahead = length
        self._high = TOLERANCE / length if length else 0.0
        self._low = -self._high


class Canvas:
    """Keep what the pens of all turtles have drawn."""

    def __init__(self) -> None:
        self.clear()

    def clear(self) -> None:
        """Remove everything that was drawn."""
        self._pixels = bytearray(SIZE * SIZE * _BYTES)
        self._strokes: list[Stroke] = []
        self._latest: dict[str, Stroke] = {}

    @property
    def strokes(self) -> tuple[Stroke, ...]:
        """All strokes in the order in which they were begun, killed turtles' included."""
        return tuple(self._strokes)

    def color_at(self, x: float, y: float) -> Rgb | None:
        """Return the colour drawn at a point of the field in pixels, or None where it is bare."""
        at = (int(y + 0.5) * SIZE + int(x + 0.5)) * _BYTES
        pixels = self._pixels
        return Rgb(pixels[at], pixels[at + 1], pixels[at + 2]) if pixels[at + 3] else None

    def draw(self, turtle: str, pen: Pen, x0: float, y0: float, x1: float, y1: float) -> None:
        """Draw a line from (x0, y0) to (x1, y1), which may lie outside.

        A line that changes no pixel is not kept as a stroke unless it prolongs one: what turtles
        trace again and again does not grow.
        """
        if not (_LOW <= x1 <= _HIGH and _LOW <= y1 <= _HIGH
                and _LOW <= x0 <= _HIGH and _LOW <= y0 <= _HIGH):  # fmt: skip
            x0, y0, x1, y1 = _clip(x0, y0, x1, y1)
        changed = self._paint(pen, x0, y0, x1, y1)
        stroke = self._latest.get(turtle)
        if stroke is None or stroke.points[-1] != (x0, y0) or stroke.pen != pen:
            if changed:
                stroke = self._latest[turtle] = Stroke(turtle, pen, x0, y0, x1, y1)
                self._strokes.append(stroke)
        elif changed:
            stroke.extend(x1, y1)
        else:
            stroke.prolong(x1, y1)

    def _paint(self, pen: Pen, x0: float, y0: float, x1: float, y1: float) -> bool:
        """Fill the pixels whose centres the pen covers. Return whether any changed."""
        dx, dy = x1 - x0, y1 - y0
        length = hypot(dx, dy)
        ux, uy = (dx / length, dy / length) if length else (1.0, 0.0)
        half = pen.width / 2
        reach = length / 2 + half
        cx, cy = (x0 + x1) / 2 - 0.5, (y0 + y1) / 2 - 0.5  # pixel i has its centre at i + 1/2
        height = reach * abs(uy) + half * abs(ux)
        top, bottom = ceil(cy - height), floor(cy + height)
        if top < 0:
            top = 0
        if bottom >= SIZE:
            bottom = SIZE - 1

        # A row meets the rectangle where it lies between its two ends and between its two sides.
        if abs(ux) < _FLAT:
            ux = _FLAT
        if abs(uy) < _FLAT:
            uy = _FLAT
        end_slope, end_half = -uy / ux, reach / abs(ux)
        side_slope, side_half = ux / uy, half / abs(uy)
        end, side = cx + (top - cy) * end_slope, cx + (top - cy) * side_slope
        pixels, ink = self._pixels, _ink(pen.color)
        changed = False
        for row in range(top * SIZE, (bottom + 1) * SIZE, SIZE):
            left, right = end - end_half, end + end_half
            if side - side_half > left:
                left = side - side_half
            if side + side_half < right:
                right = side + side_half
            first = row + ceil(left) if left > 0.0 else row
            stop = row + floor(right) + 1 if right < SIZE - 1 else row + SIZE
            if first < stop:
                span = ink[: (stop - first) * _BYTES]
                if pixels[first * _BYTES : stop * _BYTES] != span:
                    pixels[first * _BYTES : stop * _BYTES] = span
                    changed = True
            end += end_slope
            side += side_slope
        return changed


@lru_cache(maxsize=64)
def _ink(color: Rgb) -> bytes:
    """Make a row of pixels of a colour."""
    return bytes((*color, 255)) * SIZE


def _clip(x0: float, y0: float, x1: float, y1: float) -> tuple[float, float, float, float]:
    """Cut a line to the field and its margin (Liang and Barsky 1984).

    Only teleports and spawns outside need it; their float32 may be as far off as 3e38. A line
    that passes the margin by becomes a point in its corner, which leaves no mark.
    """
    if abs(x0) + abs(y0) > abs(x1) + abs(y1):  # measured from afar, the field has no extent
        x1, y1, x0, y0 = _clip(x1, y1, x0, y0)
        return x0, y0, x1, y1
    dx, dy = x1 - x0, y1 - y0
    enter, leave = 0.0, 1.0
    for start, delta in ((x0, dx), (y0, dy)):
        if delta:
            near, far = sorted(((_LOW - start) / delta, (_HIGH - start) / delta))
            enter, leave = max(enter, near), min(leave, far)
        elif not _LOW <= start <= _HIGH:
            leave = -1.0
    if enter > leave:
        return _LOW, _LOW, _LOW, _LOW
    return (
        _inside(x0 + enter * dx),
        _inside(y0 + enter * dy),
        _inside(x0 + leave * dx),
        _inside(y0 + leave * dy),
    )


def _inside(value: float) -> float:
    """Undo what rounding puts beyond the margin."""
    return min(max(value, _LOW), _HIGH)
