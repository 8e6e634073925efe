"""Cubic Bézier curves: where they run, and what they run into.

Transitions from a state to itself: loops at a side of its box.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import pairwise

from llfsm.runtime.drawing.diagram import Box, Label
from llfsm.runtime.drawing.shapes import Curve, PicturePoint


def straight(start: PicturePoint, end: PicturePoint) -> Curve:
    """Return a straight line as a curve."""
    third = PicturePoint((2 * start.x + end.x) / 3, (2 * start.y + end.y) / 3)
    return start, third, PicturePoint((start.x + 2 * end.x) / 3, (start.y + 2 * end.y) / 3), end


def through(points: Sequence[PicturePoint]) -> Curve:
    """Return the curve through points in the order of their y, vertical in each of them."""
    corners: list[PicturePoint] = []
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
            curve += PicturePoint(a.x, middle), PicturePoint(b.x, middle), b
    return tuple(curve)


def at(curve: Curve, t: float) -> tuple[PicturePoint, PicturePoint]:
    """Return the place and the direction at `t`, from 0 to 1 over all pieces."""
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
        PicturePoint(
            u**3 * a.x + 3 * u * u * t * b.x + 3 * u * t * t * c.x + t**3 * d.x,
            u**3 * a.y + 3 * u * u * t * b.y + 3 * u * t * t * c.y + t**3 * d.y,
        ),
        PicturePoint(*along),
    )


def sample(curve: Curve, number: int = 24) -> list[PicturePoint]:
    """Return points along a curve, both ends included."""
    return [at(curve, i / number)[0] for i in range(number + 1)]


def part(curve: Curve, start: float, end: float) -> Curve:
    """Return a curve of one piece cut to what is between `start` and `end`, from 0 to 1."""
    a, b, c, d = curve

    def blossom(r: float, s: float, t: float) -> PicturePoint:
        """Interpolate each of the three times at its own parameter (de Casteljau)."""
        ab, bc, cd = _mix(a, b, r), _mix(b, c, r), _mix(c, d, r)
        return _mix(_mix(ab, bc, s), _mix(bc, cd, s), t)

    return (
        blossom(start, start, start), blossom(start, start, end),
        blossom(start, end, end), blossom(end, end, end),
    )  # fmt: skip


def _mix(a: PicturePoint, b: PicturePoint, t: float) -> PicturePoint:
    return PicturePoint(a.x + (b.x - a.x) * t, a.y + (b.y - a.y) * t)


def crossing(curve: Curve, box: Box, outside: float, inside: float) -> float:
    """Return where a curve crosses the border of a box between two parameters."""
    for _ in range(40):
        middle = (outside + inside) / 2
        if contains(box, at(curve, middle)[0]):
            inside = middle
        else:
            outside = middle
    return outside


def contains(box: Box, point: PicturePoint, depth: float = 0.0) -> bool:
    """Return whether a point is inside a box, farther from its border than `depth`."""
    x, y = box.width / 2 - depth, box.height / 2 - depth
    return abs(point.x - box.x) < x and abs(point.y - box.y) < y


def hits(points: Iterable[PicturePoint], box: Box | Label, margin: float = 0) -> int:
    """Return how many points are within a box, or nearer to it than `margin`."""
    x, y = box.width / 2 + margin, box.height / 2 + margin
    return sum(abs(p.x - box.x) < x and abs(p.y - box.y) < y for p in points)


_HEIGHT = 32.0
_END = 8.0  # from a loop's middle to its ends
_SWING = 2.2  # how much wider a loop is than at its ends
_REACH = 28.0
_GAP = 3.0


def loop_room(labels: Sequence[Label]) -> tuple[float, float]:
    """Return the width that loops take beside their box, and the height of box that they need."""
    width = max((_REACH + _GAP + label.width for label in labels), default=0)
    return width, len(labels) * _pitch(labels)


def self_loops(box: Box, labels: Sequence[Label], side: int = 1) -> list[tuple[Curve, Label]]:
    """Return loops at the right of a box, or the left if `side` is -1, the first at the top.

    Their labels are in their places.
    """
    pitch = min(_pitch(labels), box.height / max(len(labels), 1))  # an editor's box may be small
    end = min(_END, 0.4 * pitch)
    y = box.y - (len(labels) - 1) / 2 * pitch
    border = box.right if side > 0 else box.left
    reach = side * _REACH / 0.75  # a curve goes three quarters of the way to its control points
    loops: list[tuple[Curve, Label]] = []
    for label in labels:
        curve = (
            PicturePoint(border, y - end),
            PicturePoint(border + reach, y - _SWING * end),
            PicturePoint(border + reach, y + _SWING * end),
            PicturePoint(border, y + end),
        )
        beside = replace(label, x=border + side * (_REACH + _GAP + label.width / 2), y=y)
        loops.append((curve, beside))
        y += pitch
    return loops


def _pitch(labels: Sequence[Label]) -> float:
    return max((_HEIGHT, *(label.height + 4 for label in labels)))
