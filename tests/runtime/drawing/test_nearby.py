"""A grid finds whatever overlaps, and a drawing compares each thing with its neighbours only."""

from __future__ import annotations

from math import inf, nan

import pytest
from hypothesis import given
from hypothesis import strategies as st

from llfsm.runtime.drawing import editor_layout
from llfsm.runtime.drawing.diagram import Arrow, Box, Label
from llfsm.runtime.drawing.editor_layout import Grid
from llfsm.runtime.engine.table import MachineLayout, StateBox

numbers = st.sampled_from([0.0, 64.0, 63.9, 1e3, -1e3, 1e6, 1e13, inf, -inf, nan]) | st.floats(
    -500, 500
)
rectangles = st.tuples(numbers, numbers, numbers.map(abs), numbers.map(abs))


@given(st.lists(rectangles, max_size=12), rectangles)
def test_whatever_overlaps_is_found(
    items: list[tuple[float, float, float, float]], where: tuple[float, float, float, float]
) -> None:
    grid: Grid[int] = Grid()
    for i, rectangle in enumerate(items):
        grid.add(i, *rectangle)
    found = grid.near(*where)
    assert found == sorted(set(found))
    x, y, width, height = where
    for i, (other_x, other_y, other_width, other_height) in enumerate(items):
        if (
            abs(x - other_x) < (width + other_width) / 2
            and abs(y - other_y) < (height + other_height) / 2
        ):
            assert i in found


def compared(count: int, monkeypatch: pytest.MonkeyPatch) -> int:
    """Return how often labels are compared when a layout of so many states is drawn."""
    boxes = [Box(f"S{i}", 0, 0, 100, 50, ()) for i in range(count)]
    places = {f"S{i}": StateBox(180.0 * (i % 5), 130.0 * (i // 5), 100, 50) for i in range(count)}
    label = Label(0, 0, 60, 16, ("x",))
    arrows = [Arrow(i, 0, (i + 1) % count, label) for i in range(count - 1)]
    calls = 0
    overlap = editor_layout.overlap

    def counting(a: Box | Label, b: Box | Label) -> float:
        nonlocal calls
        calls += isinstance(a, Label)
        return overlap(a, b)

    with monkeypatch.context() as patch:
        patch.setattr(editor_layout, "overlap", counting)
        editor_layout.editor_layout(boxes, arrows, MachineLayout(places, {}))
    return calls


def test_a_drawing_of_twice_the_size_takes_twice_the_work(monkeypatch: pytest.MonkeyPatch) -> None:
    once, twice = compared(40, monkeypatch), compared(80, monkeypatch)
    assert 0 < twice < 2.5 * once
