"""Cubic Bézier curves: points on them, pieces of them, and curves through given points.

A curve is a start and three points for each piece, of which the first two pull the piece towards
them and the third is its end. A parameter t, from 0 to 1, runs over all pieces of a curve alike.
Lengths are in units of the picture, x to the right and y down.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple, TypeAlias


class Point(NamedTuple):
    """A position in the picture."""

    x: float
    y: float


Curve: TypeAlias = tuple[Point, ...]
"""A start, and three points for each cubic Bézier piece."""


def straight(start: Point, end: Point) -> Curve:
    """Make a curve of a straight line."""
    third = Point((2 * start.x + end.x) / 3, (2 * start.y + end.y) / 3)
    return start, third, Point((start.x + 2 * end.x) / 3, (start.y + 2 * end.y) / 3), end


def through(points: Sequence[Point]) -> Curve:
    """Draw a curve through points in the order of their y, vertical in each of them."""
    corners: list[Point] = []
    for point in points:
        if corners and point.y - corners[-1].y < 0.01:
            continue
        if len(corners) > 1 and corners[-2].x == corners[-1].x == point.x:
            corners.pop()  # two straight pieces are one
        corners.append(point)
    curve = corners[:1]
    for a, b in pairwise(corners):
        if a.x == b.x:
            curve += straight(a, b)[1:]
        else:
            middle = (a.y + b.y) / 2
            curve += Point(a.x, middle), Point(b.x, middle), b
    return tuple(curve)


def at(curve: Curve, t: float) -> tuple[Point, Point]:
    """Return the place on a curve at `t`, and the direction there, of any length."""
    pieces = (len(curve) - 1) // 3
    piece = min(int(t * pieces), pieces - 1)
    t = t * pieces - piece
    a, b, c, d = curve[3 * piece : 3 * piece + 4]
    u = 1 - t
    along = [
        3 * u * u * (q - p) + 6 * u * t * (r - q) + 3 * t * t * (s - r)
        for p, q, r, s in ((a.x, b.x, c.x, d.x), (a.y, b.y, c.y, d.y))
    ]
    return (
        Point(
            u**3 * a.x + 3 * u * u * t * b.x + 3 * u * t * t * c.x + t**3 * d.x,
            u**3 * a.y + 3 * u * u * t * b.y + 3 * u * t * t * c.y + t**3 * d.y,
        ),
        Point(*along),
    )


def sample(curve: Curve, number: int = 24) -> list[Point]:
    """List `number` + 1 points along a curve, both ends included."""
    return [at(curve, i / number)[0] for i in range(number + 1)]


def part(curve: Curve, start: float, end: float) -> Curve:
    """Cut a curve of one piece to the part between `start` and `end`."""
    a, b, c, d = curve

    def blossom(r: float, s: float, t: float) -> Point:
        """Interpolate each of the three times at its own parameter (de Casteljau)."""
        ab, bc, cd = _mix(a, b, r), _mix(b, c, r), _mix(c, d, r)
        return _mix(_mix(ab, bc, s), _mix(bc, cd, s), t)

    return (
        blossom(start, start, start), blossom(start, start, end),
        blossom(start, end, end), blossom(end, end, end),
    )  # fmt: skip


def _mix(a: Point, b: Point, t: float) -> Point:
    return Point(a.x + (b.x - a.x) * t, a.y + (b.y - a.y) * t)
