"""A machine where an editor drew it; what the layout lacks is placed and routed around that."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import combinations
from math import hypot

from ..engine.layout import Layout, TransitionPath
from .curves import at, hits, sample
from .diagram import Arrow, Box, Curve, Edge, Label, Point
from .loops import self_loops

__all__ = ["has_room", "placed"]

_GAP = 40.0
_BOWS = (0.0, 30.0, -30.0, 60.0, -60.0, 90.0, -90.0, 140.0, -140.0, 220.0, -220.0)
_NEAR = 10.0  # nearer than this, two arrows look like one
_ALONG = (0.5, 0.42, 0.58, 0.34, 0.66, 0.26, 0.74, 0.18, 0.82)
_ASIDE = (0.0, 14.0, -14.0, 26.0, -26.0, 40.0, -40.0)
_COVERED = 60.0  # how bad it is to cover a point of another arrow, in units of covered area


def placed(
    boxes: Sequence[Box], arrows: Sequence[Arrow], layout: Layout
) -> tuple[list[Box], list[Edge]]:
    """Place boxes and arrows as `layout` has them."""
    boxes = _place_boxes(boxes, layout)
    curves: dict[Arrow, Curve] = {}
    labels: dict[Arrow, Label] = {}
    for arrow in arrows:
        paths = layout.transitions.get(boxes[arrow.source].state, ())
        if arrow.number < len(paths):
            path = paths[arrow.number]
            curves[arrow] = _given(path, boxes[arrow.source], boxes[arrow.target])
    for arrow in arrows:
        if arrow not in curves and arrow.source != arrow.target:
            curves[arrow] = _free_curve(arrow, boxes, curves)
    for i, box in enumerate(boxes):
        loops = [a for a in arrows if a.source == a.target == i and a not in curves]
        free = _free_loops(box, [a.label for a in loops], boxes, curves.values())
        for arrow, loop in zip(loops, free, strict=True):
            curves[arrow], labels[arrow] = loop
    samples = {arrow: sample(curve) for arrow, curve in curves.items()}
    for arrow in arrows:
        if arrow not in labels:
            others = [point for other in arrows if other != arrow for point in samples[other]]
            taken: list[Box | Label] = [*boxes, *labels.values()]
            labels[arrow] = _free_label(arrow.label, curves[arrow], taken, others)
    return boxes, [arrow.edge(boxes, curves[arrow], labels[arrow]) for arrow in arrows]


def has_room(boxes: Sequence[Box], layout: Layout) -> bool:
    """Tell whether no two boxes overlap where `layout` has them."""
    places = _place_boxes(boxes, layout)
    return not any(_overlap(a, b) for a, b in combinations(places, 2))


def _place_boxes(boxes: Sequence[Box], layout: Layout) -> list[Box]:
    """Place the boxes that the layout has, and the others in a row below."""
    known = {
        box.state: replace(box, x=given.x, y=given.y)
        for box in boxes
        if (given := layout.states.get(box.state))
    }
    x = min((box.left for box in known.values()), default=0.0)
    y = max((box.bottom for box in known.values()), default=0.0) + _GAP
    for box in boxes:
        if box.state not in known:
            here = replace(box, x=x + box.width / 2, y=y + box.height / 2)
            known[box.state] = here
            x += box.width + 2 * _GAP
    return [known[box.state] for box in boxes]


def _given(path: TransitionPath, source: Box, target: Box) -> Curve:
    """Return an editor's curve, its ends moved to the borders of our boxes."""
    return (
        _on_border(source, path.src),
        Point(*path.control1),
        Point(*path.control2),
        _on_border(target, path.dst),
    )


def _on_border(box: Box, point: tuple[float, float]) -> Point:
    """Return the point of a box's border that is nearest to `point`."""
    x = min(max(point[0], box.left), box.right)
    y = min(max(point[1], box.top), box.bottom)
    sides = [
        (abs(x - box.left), Point(box.left, y)),
        (abs(x - box.right), Point(box.right, y)),
        (abs(y - box.top), Point(x, box.top)),
        (abs(y - box.bottom), Point(x, box.bottom)),
    ]
    return min(sides)[1]


def _free_curve(arrow: Arrow, boxes: Sequence[Box], curves: dict[Arrow, Curve]) -> Curve:
    """Return a curve that bows as little as it can to keep clear of boxes and of its like."""
    ends = {arrow.source, arrow.target}
    alike = [
        point
        for other, curve in curves.items()
        if {other.source, other.target} == ends
        for point in sample(curve)[4:-4]
    ]
    others = [box for i, box in enumerate(boxes) if i not in ends]

    def clash(curve: Curve) -> int:
        points = sample(curve)
        near = sum(hypot(a.x - b.x, a.y - b.y) < _NEAR for a in points[4:-4] for b in alike)
        return near + 10 * sum(hits(points, box, _NEAR) for box in others)

    found = (_bowed(boxes[arrow.source], boxes[arrow.target], bow) for bow in _BOWS)
    return min(found, key=clash)


def _free_loops(
    box: Box, labels: Sequence[Label], boxes: Iterable[Box], curves: Iterable[Curve]
) -> list[tuple[Curve, Label]]:
    """Return loops at the side of a box where less is in their way."""
    points = [point for curve in curves for point in sample(curve)]
    others = [other for other in boxes if other is not box]

    def clash(loops: list[tuple[Curve, Label]]) -> float:
        return sum(
            _COVERED * hits(points, label, _NEAR) + sum(_overlap(label, other) for other in others)
            for _, label in loops
        )

    return min((self_loops(box, labels, side) for side in (1, -1)), key=clash)


def _bowed(source: Box, target: Box, bow: float) -> Curve:
    dx, dy = target.x - source.x, target.y - source.y
    length = hypot(dx, dy) or 1
    side = Point(-dy / length * bow, dx / length * bow)
    middle = Point((source.x + target.x) / 2 + side.x, (source.y + target.y) / 2 + side.y)
    start, end = _towards(source, middle), _towards(target, middle)
    return (
        start,
        Point((start.x + 2 * middle.x) / 3 + side.x / 6, (start.y + 2 * middle.y) / 3 + side.y / 6),
        Point((end.x + 2 * middle.x) / 3 + side.x / 6, (end.y + 2 * middle.y) / 3 + side.y / 6),
        end,
    )


def _towards(box: Box, point: Point) -> Point:
    """Return where the line from a box's centre to `point` leaves the box."""
    dx, dy = point.x - box.x, point.y - box.y
    scale = max(abs(dx) / (box.width / 2), abs(dy) / (box.height / 2))
    if not scale:
        return Point(box.x, box.bottom)
    if abs(dx) / box.width > abs(dy) / box.height:
        return Point(box.right if dx > 0 else box.left, box.y + dy / scale)
    return Point(box.x + dx / scale, box.bottom if dy > 0 else box.top)


def _free_label(
    label: Label, curve: Curve, taken: Sequence[Box | Label], others: Sequence[Point]
) -> Label:
    """Place a label on its curve or beside it, where it covers least."""

    def places() -> Iterator[Label]:
        for aside in _ASIDE:
            for t in _ALONG:
                point, way = at(curve, t)
                length = hypot(*way) or 1
                x = point.x - way.y / length * (aside + _sign(aside) * label.width / 4)
                yield replace(label, x=x, y=point.y + way.x / length * aside)

    def covered(place: Label) -> float:
        return sum(_overlap(place, item) for item in taken) + _COVERED * hits(others, place)

    return min(places(), key=covered)


def _sign(value: float) -> int:
    return (value > 0) - (value < 0)


def _overlap(a: Box | Label, b: Box | Label) -> float:
    x = (a.width + b.width) / 2 - abs(a.x - b.x)
    y = (a.height + b.height) / 2 - abs(a.y - b.y)
    return x * y if x > 0 and y > 0 else 0.0
