"""The trail of one pen, kept as the fewest points that show it.

At 62.5 points a second a trail must be thinned while it grows. A leg of a stroke runs from its
anchor to the latest point. Each point it has passed leaves a cone of slopes at which the leg still
runs within `TOLERANCE` of that point. A new point inside all those cones moves the leg's end; one
outside them, or one that turns back, is the end of a new leg. So a step costs the same however
long the trail has grown, and a straight run is one leg however long it took.
"""

from math import hypot

from .pen import Pen

__all__ = ["TOLERANCE", "Stroke"]

TOLERANCE = 0.05
"""Pixels that a point on the way may lie off the kept line: too little to see."""


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
