"""What pens draw: the pixels Qt would, and strokes that do not grow without need."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from llfsm.bridges.turtlesim.canvas import SIZE, Canvas, Pen, Rgb
from llfsm.bridges.turtlesim.simulator import Simulator

RED, GREEN = Rgb(200, 0, 0), Rgb(0, 200, 0)
points = st.floats(-20, SIZE + 20)


def pixels(canvas, rows=range(SIZE), columns=range(SIZE)):
    return {(x, y) for y in rows for x in columns if canvas.color_at(x, y)}


def test_lines_are_those_of_qt(recorded):
    """Compare with lines drawn by QPainter of Qt 5.15 on a QImage, as rows of (y, first, last)."""
    drawn = missing = excess = 0
    for line in recorded("qt_lines.json"):
        canvas = Canvas()
        canvas.draw("t", Pen(RED, line["width"]), *line["from"], *line["to"])
        qt = {(x, y) for y, first, last in line["spans"] for x in range(first, last + 1)}
        ours = pixels(canvas)
        drawn += len(qt)
        missing += len(qt - ours)
        excess += len(ours - qt)
    assert drawn > 2000
    assert missing + excess <= drawn * 0.01


@given(points, points, points, points, st.integers(1, 40))
def test_a_pixel_is_drawn_if_its_centre_is_covered(x0, y0, x1, y1, width):
    canvas = Canvas()
    canvas.draw("t", Pen(RED, width), x0, y0, x1, y1)
    length = math.hypot(x1 - x0, y1 - y0)
    ux, uy = ((x1 - x0) / length, (y1 - y0) / length) if length > 0 else (1.0, 0.0)
    for y in range(0, SIZE, 7):
        for x in range(0, SIZE, 7):
            dx, dy = x + 0.5 - (x0 + x1) / 2, y + 0.5 - (y0 + y1) / 2
            beyond = max(
                abs(dx * ux + dy * uy) - (length + width) / 2, abs(dy * ux - dx * uy) - width / 2
            )
            if abs(beyond) > 1e-4:
                assert (canvas.color_at(x, y) == RED) == (beyond < 0), (x, y)


@pytest.mark.parametrize(
    ("line", "row", "column"),
    [
        ((250.0, 250.0, 3e38, 250.0), 250, 400),
        ((250.0, -3e38, 250.0, 100.0), 50, 250),
        ((100.0, 100.0, 3e38, 3e38), 400, 400),
        ((-2000.0, 300.0, 3000.0, 300.0), 300, 250),
    ],
)
@pytest.mark.parametrize("back", [False, True])
def test_lines_to_far_outside_are_drawn_up_to_the_edge(line, row, column, back):
    canvas = Canvas()
    canvas.draw("t", Pen(RED, 5), *(line[2:] + line[:2] if back else line))
    assert canvas.color_at(column, row) == RED
    (stroke,) = canvas.strokes
    assert all(-1000 < value < 1500 for point in stroke.points for value in point)
    inside = [tuple(point) for point in (line[:2], line[2:]) if max(map(abs, point)) < 500]
    assert set(inside) <= set(stroke.points)


@pytest.mark.parametrize("line", [(-1e30, 250.0, -1e30, 260.0), (-3e38, 400.0, 400.0, -3e38)])
def test_lines_that_pass_the_field_by_leave_no_mark(line):
    canvas = Canvas()
    canvas.draw("t", Pen(RED, 255), *line)
    assert canvas.strokes == ()
    assert not pixels(canvas, range(0, SIZE, 9), range(0, SIZE, 9))


@given(*[st.floats(width=32, allow_nan=False, allow_infinity=False)] * 4)
def test_any_line_is_survived(x0, y0, x1, y1):
    canvas = Canvas()
    canvas.draw("t", Pen(RED, 5), x0, y0, x1, y1)
    for stroke in canvas.strokes:
        assert all(-301 < value < 801 for point in stroke.points for value in point)


def test_the_last_pen_is_on_top():
    canvas = Canvas()
    canvas.draw("a", Pen(RED, 5), 100, 100, 200, 100)
    canvas.draw("b", Pen(GREEN, 5), 150, 50, 150, 150)
    assert canvas.color_at(120, 100) == RED
    assert canvas.color_at(150, 100) == GREEN
    assert canvas.color_at(120, 120) is None
    assert [stroke.turtle for stroke in canvas.strokes] == ["a", "b"]


def test_a_point_has_the_colour_of_the_pixel_qt_rounds_it_to():
    canvas = Canvas()
    canvas.draw("a", Pen(RED, 2), 101, 100, 101, 110)  # the columns 100 and 101
    drawn = [x for x in (99.4, 99.5, 100.0, 101.4, 101.5) if canvas.color_at(x, 105.0)]
    assert drawn == [99.5, 100.0, 101.4]
    canvas.draw("a", Pen(GREEN, 2), 200, 101, 210, 101)  # the rows 100 and 101
    drawn = [y for y in (99.4, 99.5, 100.0, 101.4, 101.5) if canvas.color_at(205.0, y)]
    assert drawn == [99.5, 100.0, 101.4]


def test_clear_leaves_nothing():
    canvas = Canvas()
    canvas.draw("a", Pen(RED, 5), 100, 100, 200, 100)
    canvas.clear()
    assert canvas.color_at(150, 100) is None
    assert canvas.strokes == ()
    canvas.draw("a", Pen(RED, 5), 200, 100, 300, 100)
    (stroke,) = canvas.strokes
    assert stroke.points == [(200, 100), (300, 100)]


def test_a_new_pen_or_a_gap_begins_a_stroke():
    canvas = Canvas()
    canvas.draw("a", Pen(RED, 3), 100, 100, 110, 100)
    canvas.draw("a", Pen(RED, 3), 110, 100, 120, 110)
    canvas.draw("a", Pen(GREEN, 3), 120, 110, 130, 110)
    canvas.draw("a", Pen(GREEN, 3), 140, 110, 150, 110)
    assert [(stroke.pen.color, stroke.points) for stroke in canvas.strokes] == [
        (RED, [(100, 100), (110, 100), (120, 110)]),
        (GREEN, [(120, 110), (130, 110)]),
        (GREEN, [(140, 110), (150, 110)]),
    ]


def kept(simulator):
    return sum(len(stroke.points) for stroke in simulator.canvas.strokes)


def test_a_minute_straight_on_keeps_two_points():
    simulator = Simulator()
    for _ in range(3750):
        simulator.command("turtle1", 0.09, 0.0, 0.0)
        simulator.step()
    assert kept(simulator) == 2


@pytest.mark.parametrize("turn", [0.0, 1.0])
def test_what_is_traced_again_does_not_grow(turn):
    """Back and forth on a line, and round and round on a circle."""
    simulator = Simulator()
    sizes = []
    for _ in range(4):
        for step in range(6 * 393):
            simulator.command("turtle1", 2.0 if turn or step // 100 % 2 else -2.0, 0.0, turn)
            simulator.step()
        sizes.append(kept(simulator))
    assert sizes[-1] == sizes[1] < 400
