"""A stroke shows every point it was given, with few of its own."""

from itertools import pairwise
from math import cos, hypot, sin

from hypothesis import given
from hypothesis import strategies as st

from llfsm.bridges.turtlesim.canvas import TOLERANCE, Pen, Stroke

coordinates = st.floats(0, 500)


def distance(point, a, b):
    """From a point to the nearest of a line from a to b."""
    dx, dy = b[0] - a[0], b[1] - a[1]
    square = dx * dx + dy * dy
    along = ((point[0] - a[0]) * dx + (point[1] - a[1]) * dy) / square if square else 0.0
    along = min(max(along, 0.0), 1.0)
    return hypot(point[0] - a[0] - along * dx, point[1] - a[1] - along * dy)


def drawn(points):
    stroke = Stroke("turtle1", Pen(), *points[0], *points[1])
    for point in points[2:]:
        stroke.extend(*point)
    return stroke


def turns(steps):
    """The way of a turtle that takes steps of (length, turn)."""
    x, y, heading = 250.0, 250.0, 0.0
    yield x, y
    for length, turn in steps:
        heading += turn
        x, y = x + length * cos(heading), y + length * sin(heading)
        yield x, y


ways = st.one_of(
    st.lists(st.tuples(coordinates, coordinates), min_size=2, max_size=40),
    st.lists(st.tuples(st.floats(0, 3), st.floats(-0.1, 0.1)), min_size=1, max_size=200).map(
        lambda steps: list(turns(steps))
    ),
)


@given(ways)
def test_every_point_lies_on_the_stroke(points):
    kept = drawn(points).points
    assert kept[0] == points[0]
    assert kept[-1] == points[-1]
    for point in points:
        nearest = min(distance(point, a, b) for a, b in pairwise(kept))
        assert nearest <= TOLERANCE + 1e-9


@given(st.floats(-3, 3), st.floats(0.01, 3))
def test_a_straight_way_is_one_leg(heading, step):
    points = list(turns([(step, heading)] + [(step, 0.0)] * 100))
    assert len(drawn(points).points) == 2


def test_a_full_circle_takes_few_legs():
    points = list(turns([(1.44, 0.016)] * 393))  # 2 m/s and 1 rad/s
    assert len(drawn(points).points) < 120


def test_turning_back_is_kept():
    points = [(100.0, 100.0), (150.0, 100.0), (120.0, 100.0)]
    assert drawn(points).points == points


def test_prolonging_refuses_to_bend():
    stroke = drawn([(0.0, 0.0), (10.0, 0.0)])
    assert stroke.prolong(20.0, 0.0)
    assert not stroke.prolong(25.0, 5.0)
    assert not stroke.prolong(15.0, 0.0)
    assert stroke.points == [(0.0, 0.0), (20.0, 0.0)]
