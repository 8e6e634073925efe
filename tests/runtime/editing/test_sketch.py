"""The drawing of a bundle while it is edited."""

from __future__ import annotations

from itertools import combinations
from pathlib import Path

import pytest

import llfsm.machines
from llfsm.runtime.bundles import Bundle, BundleState, BundleTransition, Fragment, read_bundle
from llfsm.runtime.drawing.editor_layout import overlap
from llfsm.runtime.editing.sketch import sketch
from llfsm.runtime.engine.table import MachineLayout, StateBox

SHIPPED = sorted(Path(llfsm.machines.__file__).parent.glob("*.machine"))


def in_a_row(distance: float, width: float = 100) -> Bundle:
    """Return four states, each with transitions to both neighbours."""
    names = "ABCD"
    states = tuple(
        BundleState(
            name,
            transitions=tuple(
                BundleTransition(names[(i + by) % 4], Fragment("far > 4\n")) for by in (1, -1)
            ),
        )
        for i, name in enumerate(names)
    )
    boxes = {name: StateBox(i * distance, 0, width, 50) for i, name in enumerate(names)}
    return Bundle("M", states, layout=MachineLayout(boxes))


@pytest.mark.parametrize("path", SHIPPED, ids=[each.stem for each in SHIPPED])
def test_labels_of_machines_that_ship_cover_nothing(path: Path) -> None:
    drawn = sketch(read_bundle(path))
    labels = [edge.label for edge in drawn.edges]
    assert not [pair for pair in combinations(labels, 2) if overlap(*pair)]
    assert not [box.state for box in drawn.boxes for label in labels if overlap(label, box)]


def test_labels_where_states_are_crowded_cover_nothing() -> None:
    drawn = sketch(in_a_row(160))
    labels = [edge.label for edge in drawn.edges]
    assert len(labels) == 8
    assert not [pair for pair in combinations(labels, 2) if overlap(*pair)]
    assert not [box.state for box in drawn.boxes for label in labels if overlap(label, box)]


@pytest.mark.parametrize(("distance", "width"), [(1e15, 100), (200, 1e12), (1e300, 1e300)])
def test_what_is_far_away_or_large_is_drawn(distance: float, width: float) -> None:
    assert len(sketch(in_a_row(distance, width)).edges) == 8
