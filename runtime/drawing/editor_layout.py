"""A machine at the positions of an editor; what its layout lacks is placed and routed around.

Boxes stand where the layout has them, others in a row below, and arrows follow its paths. Two
things need care. Text may need more room than the editor gave a box: boxes that then cover each
other are moved apart, and the ends of their arrows with them. And a path leads to an editor's
border of a box, not to ours: it is cut where it crosses our border, and dropped if too little is
left to see an arrow.

Arrows without a path, loops and labels each try a few places, the best first, and take the one
that covers least: a bow that keeps clear of boxes and of other arrows between the same two, the
side of a box for loops, a place on the curve or beside it for a label. A `Grid` finds what is near,
so that each thing is compared with its neighbours only, and a drawing of twice the size takes
twice the work.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import combinations, pairwise
from math import floor, hypot, inf
from typing import Generic, TypeVar

from llfsm.runtime.drawing.automatic_layout import self_loops
from llfsm.runtime.drawing.curves import Curve, Point, at, part, sample
from llfsm.runtime.drawing.diagram import HEAD, Arrow, Box, Edge, Label, arrow_head
from llfsm.runtime.engine.table import MachineLayout, TransitionPath

_GAP = 40.0
_BOWS = (0.0, 30.0, -30.0, 60.0, -60.0, 90.0, -90.0, 140.0, -140.0, 220.0, -220.0)
_NEAR = 10.0  # nearer than this, two arrows look like one
_ALONG = (0.5, 0.42, 0.58, 0.34, 0.66, 0.26, 0.74, 0.18, 0.82)
_ASIDE = (0.0, 14.0, -14.0, 26.0, -26.0, 40.0, -40.0)
_BETWEEN = 28.0  # boxes that had to be moved apart
_ROUNDS = 20  # of moving boxes apart, after which they may still cover each other
_STEPS = 96  # in which a curve is searched for the borders of boxes
_TOUCH = 0.5  # an editor's curve may end so far inside a box by rounding alone
_COVERED = 60.0  # how bad it is to cover a point of another arrow, in units of covered area

_CELL = 160.0
_MOST = 4096.0  # half the width and height of what is in cells, and looked for in them
_FAR = 1e12  # beyond, the cells cannot be numbered exactly

Item = TypeVar("Item")
Place = TypeVar("Place")


def editor_layout(
    boxes: Sequence[Box], arrows: Sequence[Arrow], layout: MachineLayout
) -> tuple[list[Box], list[Edge]]:
    """Place boxes and arrows as `layout` has them.

    Boxes that would cover each other are moved apart, and the ends of their arrows with them.
    """
    there = place_boxes(boxes, layout)
    boxes = _apart(there, layout)
    moves = [Point(box.x - old.x, box.y - old.y) for box, old in zip(boxes, there, strict=True)]
    around: Grid[int] = Grid()
    for i, box in enumerate(boxes):
        around.add(i, box.x, box.y, box.width, box.height)
    curves: dict[Arrow, Curve] = {}
    labels: dict[Arrow, Label] = {}
    for arrow in arrows:
        paths = layout.transitions.get(boxes[arrow.source].state, ())
        if arrow.number < len(paths):
            path = moved_path(paths[arrow.number], moves[arrow.source], moves[arrow.target])
            curve = given_curve(path, boxes[arrow.source], boxes[arrow.target])
            if curve is not None:
                curves[arrow] = curve
    alike: dict[frozenset[int], list[Point]] = {}  # points of the arrows between two boxes
    for arrow in [*curves, *(each for each in arrows if each not in curves)]:
        if arrow not in curves and arrow.source != arrow.target:
            beside = alike.get(_ends(arrow), [])
            curves[arrow] = _free_curve(arrow, boxes, around, beside)
        if arrow in curves:
            alike.setdefault(_ends(arrow), []).extend(sample(curves[arrow])[4:-4])
    points: Grid[tuple[Point, Arrow]] = Grid()
    for arrow, curve in curves.items():
        _add_points(points, arrow, curve)
    loops: dict[int, list[Arrow]] = {}
    for arrow in arrows:
        if arrow not in curves:
            loops.setdefault(arrow.source, []).append(arrow)
    for i, own in sorted(loops.items()):
        free = _free_loops(i, [arrow.label for arrow in own], boxes, around, points)
        for arrow, (curve, label) in zip(own, free, strict=True):
            curves[arrow], labels[arrow] = curve, label
            _add_points(points, arrow, curve)
    taken: Grid[Box | Label] = Grid()
    placed: list[Box | Label] = [*boxes, *labels.values()]
    for item in placed:
        taken.add(item, item.x, item.y, item.width, item.height)
    for arrow in arrows:
        if arrow not in labels:
            label = labels[arrow] = _free_label(arrow, curves[arrow], taken, points)
            taken.add(label, label.x, label.y, label.width, label.height)
    return boxes, [arrow.edge(boxes, curves[arrow], labels[arrow]) for arrow in arrows]


def has_room(boxes: Sequence[Box], layout: MachineLayout) -> bool:
    """Check that no two boxes overlap at their positions in `layout`."""
    places = place_boxes(boxes, layout)
    return not any(overlap(a, b) for a, b in combinations(places, 2))


def place_boxes(boxes: Sequence[Box], layout: MachineLayout) -> list[Box]:
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


def _apart(boxes: Sequence[Box], layout: MachineLayout) -> list[Box]:
    """Move boxes apart that cover each other.

    Of two, the one moves that needs more room than its editor gave it, or else the later.
    """
    places = list(boxes)
    grown = [
        box.width * box.height - given.w * given.h
        if (given := layout.states.get(box.state))
        else 0.0
        for box in boxes
    ]
    for _ in range(_ROUNDS):
        moved = False
        for i, j in combinations(range(len(places)), 2):
            a, b = places[i], places[j]
            if not overlap(a, b):
                continue
            moved = True
            if grown[i] > grown[j]:
                places[i] = _beside(a, b)
            else:
                places[j] = _beside(b, a)
        if not moved:
            break
    return places


def _beside(box: Box, other: Box) -> Box:
    """Move a box the shortest way to where an arrow fits between it and another one."""
    x = (box.width + other.width) / 2 + _BETWEEN
    y = (box.height + other.height) / 2 + _BETWEEN
    if x - abs(box.x - other.x) <= y - abs(box.y - other.y):
        return replace(box, x=other.x + (x if box.x >= other.x else -x))
    return replace(box, y=other.y + (y if box.y >= other.y else -y))


def moved_path(
    path: TransitionPath, source: tuple[float, float], target: tuple[float, float]
) -> TransitionPath:
    """Move the two halves of a path as its boxes have moved."""
    points = (path.src, path.dst, path.control1, path.control2)
    moves = zip(points, (source, target, source, target), strict=True)
    return TransitionPath(*((x + dx, y + dy) for (x, y), (dx, dy) in moves))


def given_curve(path: TransitionPath, source: Box, target: Box) -> Curve | None:
    """Cut an editor's curve to the part between our boxes, which may be larger than its own.

    None if so little of it is left that no arrow can be seen, or if its head is inside the target.
    """
    curve: Curve = (
        _outside(source, path.src), Point(*path.control1),
        Point(*path.control2), _outside(target, path.dst),
    )  # fmt: skip
    steps = [i / _STEPS for i in range(_STEPS + 1)]
    places = [at(curve, t)[0] for t in steps]
    in_source, in_target = (
        [contains(box, place, _TOUCH) for place in places] for box in (source, target)
    )
    if source is target:
        first, last = _longest_run(in_source)
    else:
        last = in_target.index(True) - 1 if any(in_target) else _STEPS
        first = max((i + 1 for i in range(last + 1) if in_source[i]), default=0)
    if first > last:
        return None
    start = crossing(curve, source, steps[first], steps[first - 1]) if first else 0.0
    end = crossing(curve, target, steps[last], steps[last + 1]) if last < _STEPS else 1.0
    if (start, end) != (0.0, 1.0):
        curve = part(curve, start, end)
    curve = (_on_border(source, curve[0]), *curve[1:3], _on_border(target, curve[3]))
    length = sum(hypot(b.x - a.x, b.y - a.y) for a, b in pairwise(sample(curve)))
    _, left, right = arrow_head(curve)
    base = Point((left.x + right.x) / 2, (left.y + right.y) / 2)
    return curve if length > 2 * HEAD and not contains(target, base, _TOUCH) else None


def _longest_run(inside: Sequence[bool]) -> tuple[int, int]:
    """Find first and last index of the longest run outside; (0, -1) if there is none."""
    best, first = (0, -1), 0
    for i, within in enumerate([*inside, True]):
        if within:
            best, first = max(best, (first, i - 1), key=lambda run: run[1] - run[0]), i + 1
    return best


def _outside(box: Box, point: tuple[float, float]) -> Point:
    """Move a point outside of `box` to its border; one inside stays."""
    place = Point(*point)
    return place if contains(box, place) else _on_border(box, place)


def _on_border(box: Box, point: tuple[float, float]) -> Point:
    """Find the point of a box's border that is nearest to `point`."""
    x = min(max(point[0], box.left), box.right)
    y = min(max(point[1], box.top), box.bottom)
    sides = [
        (abs(x - box.left), Point(box.left, y)),
        (abs(x - box.right), Point(box.right, y)),
        (abs(y - box.top), Point(x, box.top)),
        (abs(y - box.bottom), Point(x, box.bottom)),
    ]
    return min(sides)[1]


def _ends(arrow: Arrow) -> frozenset[int]:
    return frozenset((arrow.source, arrow.target))


def _add_points(points: Grid[tuple[Point, Arrow]], arrow: Arrow, curve: Curve) -> None:
    for point in sample(curve):
        points.add((point, arrow), point.x, point.y)


def _free_curve(
    arrow: Arrow, boxes: Sequence[Box], around: Grid[int], alike: Sequence[Point]
) -> Curve:
    """Find the curve that bows least and keeps clear of boxes and of `alike`, its parallels."""
    ends = _ends(arrow)

    def clash(curve: Curve) -> int:
        points = sample(curve)
        near = sum(hypot(a.x - b.x, a.y - b.y) < _NEAR for a in points[4:-4] for b in alike)
        hit = sum(
            hits((point,), boxes[i], _NEAR)
            for point in points
            for i in around.near(point.x, point.y, 2 * _NEAR, 2 * _NEAR)
            if i not in ends
        )
        return near + 10 * hit

    found = (bowed_curve(boxes[arrow.source], boxes[arrow.target], bow) for bow in _BOWS)
    return _best(found, clash)


def _free_loops(
    i: int,
    labels: Sequence[Label],
    boxes: Sequence[Box],
    around: Grid[int],
    points: Grid[tuple[Point, Arrow]],
) -> list[tuple[Curve, Label]]:
    """Draw loops at the side of box `i` where less is in their way."""

    def clash(loops: list[tuple[Curve, Label]]) -> float:
        return sum(
            _COVERED * _covered(points, label, _NEAR)
            + sum(
                overlap(label, boxes[other])
                for other in around.near(label.x, label.y, label.width, label.height)
                if other != i
            )
            for _, label in loops
        )

    return _best((self_loops(boxes[i], labels, side) for side in (1, -1)), clash)


def _covered(
    points: Grid[tuple[Point, Arrow]],
    label: Label,
    margin: float = 0,
    own: Arrow | None = None,
) -> int:
    """Count the points of other arrows within a label, or nearer to it than `margin`."""
    near = points.near(label.x, label.y, label.width + 2 * margin, label.height + 2 * margin)
    return hits((point for point, arrow in near if arrow is not own), label, margin)


def _best(places: Iterable[Place], cost: Callable[[Place], float]) -> Place:
    """Choose the first place of the least cost; behind one that costs nothing, none is tried."""
    best, least = None, inf
    for place in places:
        now = cost(place)
        if best is None or now < least:
            best, least = place, now
        if not now:
            break
    assert best is not None
    return best


def bowed_curve(source: Box, target: Box, bow: float) -> Curve:
    """Draw a curve between two boxes whose middle is `bow` to the left of the straight line."""
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
    """Find the point at which the line from a box's centre to `point` leaves the box."""
    dx, dy = point.x - box.x, point.y - box.y
    scale = max(abs(dx) / (box.width / 2), abs(dy) / (box.height / 2))
    if not scale:
        return Point(box.x, box.bottom)
    if abs(dx) / box.width > abs(dy) / box.height:
        return Point(box.right if dx > 0 else box.left, box.y + dy / scale)
    return Point(box.x + dx / scale, box.bottom if dy > 0 else box.top)


def _free_label(
    arrow: Arrow, curve: Curve, taken: Grid[Box | Label], points: Grid[tuple[Point, Arrow]]
) -> Label:
    """Place a label on its curve or beside it, where it covers least."""
    label = arrow.label

    def covered(place: Label) -> float:
        near = taken.near(place.x, place.y, place.width, place.height)
        return sum(overlap(place, item) for item in near) + _COVERED * _covered(
            points, place, own=arrow
        )

    return _best((replace(label, x=x, y=y) for x, y in label_places(label, curve)), covered)


def label_places(
    label: Label, curve: Curve, asides: Sequence[float] = _ASIDE, along: Sequence[float] = _ALONG
) -> Iterator[Point]:
    """Give places for a label on its curve, then beside it, the best first."""
    for aside in asides:
        for t in along:
            point, way = at(curve, t)
            length = hypot(*way) or 1
            x = point.x - way.y / length * (aside + _sign(aside) * label.width / 4)
            yield Point(x, point.y + way.x / length * aside)


def _sign(value: float) -> int:
    return (value > 0) - (value < 0)


# What covers what


def overlap(a: Box | Label, b: Box | Label) -> float:
    """Return the area that two rectangles have in common."""
    x = (a.width + b.width) / 2 - abs(a.x - b.x)
    y = (a.height + b.height) / 2 - abs(a.y - b.y)
    return x * y if x > 0 and y > 0 else 0.0


def contains(box: Box, point: Point, depth: float = 0.0) -> bool:
    """Check that a point is inside a box, farther from its border than `depth`."""
    x, y = box.width / 2 - depth, box.height / 2 - depth
    return abs(point.x - box.x) < x and abs(point.y - box.y) < y


def hits(points: Iterable[Point], box: Box | Label, margin: float = 0) -> int:
    """Count the points within a box, or nearer to it than `margin`."""
    x, y = box.width / 2 + margin, box.height / 2 + margin
    return sum(abs(p.x - box.x) < x and abs(p.y - box.y) < y for p in points)


def crossing(curve: Curve, box: Box, outside: float, inside: float) -> float:
    """Find the parameter at which a curve crosses a box's border, by halving: just outside."""
    for _ in range(40):
        middle = (outside + inside) / 2
        if contains(box, at(curve, middle)[0]):
            inside = middle
        else:
            outside = middle
    return outside


class Grid(Generic[Item]):
    """Items with a width and a height around their centres, found by where they are."""

    def __init__(self) -> None:
        self._items: list[Item] = []
        self._cells: dict[tuple[int, int], list[int]] = {}
        self._anywhere: list[int] = []  # what is too large for cells, or without a place

    def add(self, item: Item, x: float, y: float, width: float = 0.0, height: float = 0.0) -> None:
        """Add an item around its centre (x, y)."""
        number = len(self._items)
        self._items.append(item)
        if _fits(x, y, width, height):
            for cell in _cells(x, y, width, height):
                self._cells.setdefault(cell, []).append(number)
        else:
            self._anywhere.append(number)

    def near(self, x: float, y: float, width: float = 0.0, height: float = 0.0) -> list[Item]:
        """List all items that overlap a rectangle, and a few more, in the order of adding."""
        if not _fits(x, y, width, height):
            return list(self._items)
        found = set(self._anywhere)
        for cell in _cells(x, y, width, height):
            found.update(self._cells.get(cell, ()))
        return [self._items[number] for number in sorted(found)]


def _fits(x: float, y: float, width: float, height: float) -> bool:
    """Check that a rectangle has few cells; one that is not finite has none."""
    return abs(x) + abs(y) < _FAR and width < 2 * _MOST and height < 2 * _MOST


def _cells(x: float, y: float, width: float, height: float) -> Iterator[tuple[int, int]]:
    columns = range(floor((x - width / 2) / _CELL), floor((x + width / 2) / _CELL) + 1)
    rows = range(floor((y - height / 2) / _CELL), floor((y + height / 2) / _CELL) + 1)
    return ((column, row) for column in columns for row in rows)
