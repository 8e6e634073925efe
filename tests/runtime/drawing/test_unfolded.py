"""Machines are drawn inside the states that run them."""

from __future__ import annotations

import re
from collections.abc import Iterator
from itertools import combinations, pairwise
from typing import NamedTuple
from xml.etree import ElementTree as Xml

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from llfsm.runtime import Machine, State
from llfsm.runtime.drawing import arrange, to_svg
from llfsm.runtime.engine.machine import define
from llfsm.runtime.engine.table import MachineLayout, StateBox, Table
from thoroughness import examples


class Drawn(NamedTuple):
    """A state in a picture: its name and those around it, and the corners of its box."""

    path: tuple[str, ...]
    left: float
    top: float
    right: float
    bottom: float

    def holds(self, other: Drawn) -> bool:
        return (
            self.left <= other.left
            and self.top <= other.top
            and self.right >= other.right
            and self.bottom >= other.bottom
        )


def states(
    element: Xml.Element, path: tuple[str, ...] = (), x: float = 0, y: float = 0
) -> Iterator[Drawn]:
    """Yield the states of an SVG, those inside others after them."""
    moved = re.match(r"translate\((\S+) (\S+)\)", element.get("transform", ""))
    if moved:
        x, y = x + float(moved[1]), y + float(moved[2])
    name = element.get("data-state") or element.get("data-machine")
    path = (*path, name) if name else path
    if element.get("data-state"):
        box = next(each for each in element if each.tag.endswith("rect"))
        left, top = x + float(box.get("x", "")), y + float(box.get("y", ""))
        yield Drawn(
            path, left, top, left + float(box.get("width", "")), top + float(box.get("height", ""))
        )
    for each in element:
        yield from states(each, path, x, y)


def drawn(table: Table, *, sections: bool = False) -> list[Drawn]:
    picture = to_svg(arrange(table, unfold=lambda _: None, sections=sections))
    return [*states(Xml.fromstring(picture))]


shapes = st.recursive(
    st.just([[]]), lambda inner: st.lists(st.lists(inner, max_size=3), min_size=1, max_size=4)
)


def made(shape: list[list[object]], number: Iterator[int]) -> type[Machine]:
    """Make a machine: a list of its states, each a list of the machines that it runs."""
    chain = [
        State(f"S{i}", runs=[made(each, number) for each in runs] or None)  # type: ignore[arg-type]
        for i, runs in enumerate(shape)
    ]
    for state, following in pairwise(chain):
        state.to(following, after_ms=10)
    return define(f"M{next(number)}", chain)


def count(shape: list[list[object]]) -> int:
    return sum(1 + sum(count(each) for each in runs) for runs in shape)  # type: ignore[arg-type]


@settings(max_examples=examples(60), deadline=None)
@given(shape=shapes, sections=st.booleans())
def test_what_a_state_runs_is_inside_its_box_and_covers_nothing(shape, sections) -> None:  # type: ignore[no-untyped-def]
    found = drawn(made(shape, iter(range(1000))).table, sections=sections)
    assert len(found) == count(shape)
    for one, other in combinations(found, 2):
        if other.path[: len(one.path)] == one.path:
            assert one.holds(other)
        else:
            apart = one.right <= other.left or other.right <= one.left
            assert apart or one.bottom <= other.top or other.bottom <= one.top


class Leaf(Machine):
    only = State(final=False)


class Self(Machine):
    again = State(runs=lambda self: Self() if self.name else Leaf())


class Named(Machine):
    here = State(runs=["Leaf", "Gone"])


def test_one_that_runs_itself_is_named_inside() -> None:
    assert [each.path for each in drawn(Self.table)] == [("again",)]
    assert "Self or Leaf" in to_svg(arrange(Self.table, unfold=lambda _: None))


def test_those_that_are_only_named_are_found_or_named() -> None:
    picture = to_svg(arrange(Named.table, unfold={"Leaf": Leaf.table}.get))
    found = [each.path for each in states(Xml.fromstring(picture))]
    assert found == [("here",), ("here", "runs Leaf", "only")]
    assert ">Gone<" in picture


def test_a_layout_that_shows_sections_cuts_nothing_there() -> None:
    outer = define("Outer", [State("A", runs=[Leaf])])
    outer.table.layout = MachineLayout({"A": StateBox(0, 0, 60, 30, expanded=True)})
    picture = to_svg(arrange(outer.table, unfold=lambda _: None))
    assert [each.path for each in states(Xml.fromstring(picture))] == [
        ("A",),
        ("A", "runs Leaf", "only"),
    ]
    assert picture.count("Leaf<") == 1  # it is not in a list, too


@pytest.mark.parametrize("table", [Leaf.table, Named.table])
def test_where_nothing_is_unfolded_the_picture_is_the_same(table: Table) -> None:
    assert arrange(table, unfold=lambda _: None) == arrange(table)
