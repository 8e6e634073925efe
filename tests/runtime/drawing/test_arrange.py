"""The geometry of pictures."""

from __future__ import annotations

import warnings
from itertools import combinations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from llfsm.machines import RosWallTurttleBot
from llfsm.runtime import Machine, State, define
from llfsm.runtime.drawing import Box, Diagram, Label, Point, arrange
from llfsm.runtime.drawing.curves import sample
from llfsm.runtime.drawing.diagram import arrow_head
from llfsm.runtime.drawing.editor_layout import contains
from llfsm.runtime.drawing.typeset import numbered_labels, wrap
from llfsm.runtime.engine.table import MachineLayout, StateBox, TransitionPath
from thoroughness import examples

from .conftest import machine, machines

HARD = {
    "one state": machine([], ["only"]),
    "chain": machine([(i, i + 1, f"go{i}") for i in range(9)], [f"S{i}" for i in range(10)]),
    "star": machine(
        [arc for i in range(1, 12) for arc in ((0, i, f"to {i}"), (i, 0, "home"))],
        [f"S{i}" for i in range(12)],
    ),
    "loops": machine([(0, 0, f"again {i}" * i) for i in range(1, 9)], ["A"]),
    "many between two": machine(
        [(i % 2, 1 - i % 2, f"swap {i}") for i in range(10)], ["A", "B"]
    ),
    "unreachable": machine([(1, 0, "a"), (2, 1, "b"), (3, 3, "c")], list("ABCDE"), suspend=4),
    "dense": machine(
        [(i, (i * k + 7) % 30, f"when_{i}_{k}") for i in range(30) for k in (1, 3)],
        [f"STATE_{i}" for i in range(30)],
    ),
    "long labels": machine(
        [(i, (i + 1) % 4, "self.battery.voltage < 11.1 and not self.done " * 3) for i in range(4)],
        ["A", "B", "C", "D"],
    ),
    "shipped": RosWallTurttleBot,
}  # fmt: skip

hard = pytest.mark.parametrize("drawn", HARD.values(), ids=HARD)


def overlap(a: Box | Label, b: Box | Label) -> bool:
    return (
        abs(a.x - b.x) < (a.width + b.width) / 2 - 0.01
        and abs(a.y - b.y) < (a.height + b.height) / 2 - 0.01
    )


def on_border(point: Point, box: Box) -> bool:
    dx, dy = abs(point.x - box.x) - box.width / 2, abs(point.y - box.y) - box.height / 2
    return max(dx, dy) == pytest.approx(0, abs=1e-6)


def check_complete(drawn: type[Machine], diagram: Diagram) -> None:
    """All there is to draw is there, its arrows end at its boxes, and all is in the frame."""
    table = drawn.table
    assert [box.state for box in diagram.boxes] == [state.name for state in table.states]
    boxes = {box.state: box for box in diagram.boxes}
    transitions = [(s, n, t) for s in table.states for n, t in enumerate(s.transitions)]
    assert [(edge.source, edge.number, edge.target) for edge in diagram.edges] == [
        (state.name, number, transition.target.name) for state, number, transition in transitions
    ]
    labels = [label for state in table.states for label in numbered_labels(state)]
    assert [edge.label.lines for edge in diagram.edges] == [wrap(label) for label in labels]
    for edge in diagram.edges:
        assert on_border(edge.curve[0], boxes[edge.source]), edge
        assert on_border(edge.curve[-1], boxes[edge.target]), edge
    assert on_border(diagram.start[-1], boxes[table.initial.name])
    for item in (*diagram.boxes, *(edge.label for edge in diagram.edges)):
        assert diagram.left < item.x - item.width / 2
        assert item.x + item.width / 2 < diagram.left + diagram.width
        assert diagram.top < item.y - item.height / 2
        assert item.y + item.height / 2 < diagram.top + diagram.height


def check_clear(diagram: Diagram) -> None:
    """Nothing covers a box or a label; arrows touch only the boxes that they join."""
    items = [*diagram.boxes, *(edge.label for edge in diagram.edges)]
    for a, b in combinations(items, 2):
        assert not overlap(a, b), (a, b)
    for edge in diagram.edges:
        for box in diagram.boxes:
            for point in sample(edge.curve, 60)[1:-1]:
                inside = (
                    abs(point.x - box.x) < box.width / 2 - 0.1
                    and abs(point.y - box.y) < box.height / 2 - 0.1
                )
                assert not inside, (edge, box)


@hard
@pytest.mark.parametrize("sections", [False, True])
def test_hard_machines_are_drawn_clearly(drawn: type[Machine], sections: bool) -> None:
    diagram = arrange(drawn.table, sections=sections)
    check_complete(drawn, diagram)
    check_clear(diagram)


@settings(max_examples=examples(20), deadline=None)
@given(machines())
def test_any_machine_is_drawn_clearly(drawn: type[Machine]) -> None:
    diagram = arrange(drawn.table)
    check_complete(drawn, diagram)
    check_clear(diagram)
    assert arrange(drawn.table) == diagram


@hard
def test_the_initial_state_is_at_the_top(drawn: type[Machine]) -> None:
    diagram = arrange(drawn.table)
    if drawn is not HARD["unreachable"]:
        assert diagram.boxes[0].top == min(box.top for box in diagram.boxes)
    assert diagram.start[0].y < diagram.boxes[0].top


def test_states_are_marked() -> None:
    first, last, suspended = State("A"), State("B"), State("C", suspend=True)
    first.to(last)
    suspended.to(suspended, after_ms=1)
    table = define("Marked", [first, last, suspended]).table
    marks = [(box.initial, box.accepting, box.suspend) for box in arrange(table).boxes]
    assert marks == [(True, False, False), (False, True, False), (False, False, True)]


def test_a_long_chain_back_runs_straight() -> None:
    """A line through many layers bends near its ends only."""
    drawn = machine(
        [*((i, i + 1, "on") for i in range(12)), (12, 0, "back")], list("ABCDEFGHIJKLM")
    )
    back = arrange(drawn.table).edges[-1]
    assert len(back.curve) <= 1 + 3 * 5  # the ends, two bends and one line between
    assert len({point.x for point in back.curve[6:10]}) == 1


# Layouts


def laid_out(drawn: type[Machine], layout: MachineLayout) -> Diagram:
    drawn.table.layout = layout
    return arrange(drawn.table)


places = st.floats(-2000, 2000)
boxes = st.builds(
    StateBox, places, places, st.floats(0, 300), st.floats(0, 300), st.booleans(), st.just({})
)
points = st.tuples(places, places)
paths = st.builds(TransitionPath, points, points, points, points)


@settings(max_examples=examples(20), deadline=None)
@given(machines(), st.data())
def test_any_layout_is_drawn(drawn: type[Machine], data: st.DataObject) -> None:
    """Also one that lacks states or transitions, or has too many."""
    some = st.sampled_from([*(state.name for state in drawn.table.states), "no such state"])
    layout = MachineLayout(
        data.draw(st.dictionaries(some, boxes, min_size=1)),
        data.draw(st.dictionaries(some, st.lists(paths, max_size=4).map(tuple))),
    )
    diagram = laid_out(drawn, layout)
    check_complete(drawn, diagram)
    if layout.states.keys() == {"no such state"}:
        return
    for box in diagram.boxes:
        if given := layout.states.get(box.state):
            assert box.width >= given.w
            assert box.height >= given.h


@settings(max_examples=examples(20), deadline=None)
@given(machines(), st.data())
def test_a_layout_with_room_is_kept(drawn: type[Machine], data: st.DataObject) -> None:
    """Boxes stand where the editor has them, curves run where they are not under a box."""
    states = drawn.table.states
    layout = MachineLayout(
        {
            state.name: StateBox(700.0 * i, 300.0 * (i % 3), 90, 50)
            for i, state in enumerate(states)
        },
        {
            state.name: data.draw(
                st.lists(paths, max_size=len(state.transitions)).map(tuple), label=state.name
            )
            for state in states
        },
    )
    diagram = laid_out(drawn, layout)
    check_complete(drawn, diagram)
    boxes = {box.state: box for box in diagram.boxes}
    for name, place in layout.states.items():
        assert (boxes[name].x, boxes[name].y) == (place.x, place.y)
    for edge in diagram.edges:
        source, target = boxes[edge.source], boxes[edge.target]
        _, left, right = arrow_head(edge.curve)
        base = Point((left.x + right.x) / 2, (left.y + right.y) / 2)
        assert not contains(target, base, 1), "the head can be seen"
        paths_of_source = layout.transitions[edge.source]
        if edge.number < len(paths_of_source):
            path = paths_of_source[edge.number]
            ends = (
                on_border(Point(*path.src), source),
                on_border(Point(*path.dst), target),
            )
            run = (
                Point(*path.src),
                Point(*path.control1),
                Point(*path.control2),
                Point(*path.dst),
            )
            clear = not any(
                contains(box, point) for point in sample(run, 200) for box in (source, target)
            )
            if all(ends) and clear:
                assert edge.curve == run


def test_an_arrow_that_ends_inside_a_box_is_cut_at_its_border() -> None:
    """Editors let curves run to a box's middle, and names may need larger boxes than theirs."""
    drawn = machine([(0, 1, "a"), (1, 1, "b"), (1, 0, "c")], ["A", "B"])
    layout = MachineLayout(
        {"A": StateBox(0, 0, 100, 50), "B": StateBox(400, 0, 100, 50)},
        {
            "A": (TransitionPath((0, 0), (400, 0), (150, 0), (390, 0)),),
            "B": (
                TransitionPath((400, 0), (440, 0), (400, -200), (480, -200)),
                TransitionPath((400, 10), (395, 12), (400, 15), (396, 14)),
            ),
        },
    )
    first, loop, hidden = laid_out(drawn, layout).edges
    assert first.curve[0] == pytest.approx((50, 0), abs=0.01)
    assert first.curve[-1] == pytest.approx((350, 0), abs=0.01)
    assert [point.y for point in (loop.curve[0], loop.curve[-1])] == [-25, -25]
    assert (hidden.curve[0].x, hidden.curve[-1].x) == (350, 50)  # nothing was left of it


def test_boxes_that_cover_each_other_are_moved_apart() -> None:
    """Such as an editor's dot that needs a box for its name here."""
    drawn = machine([(0, 1, "true")], ["InitialPseudoState", "Initial"])
    path = TransitionPath((52, 40), (70, 45), (60, 40), (65, 44))
    layout = MachineLayout(
        {"InitialPseudoState": StateBox(40, 40, 25, 25), "Initial": StateBox(120, 60, 100, 50)},
        {"InitialPseudoState": (path,)},
    )
    diagram = laid_out(drawn, layout)
    check_clear(diagram)
    dot, box = diagram.boxes
    assert (box.x, box.y) == (120, 60)
    assert dot.y < box.y
    check_complete(drawn, diagram)


def test_states_that_a_layout_lacks_are_placed_clear_of_the_others() -> None:
    drawn = machine([(0, 1, "a"), (1, 0, "b"), (1, 2, "c"), (2, 3, "d"), (3, 3, "e")], list("ABCD"))
    layout = MachineLayout({"A": StateBox(100, 100, 80, 40), "B": StateBox(400, 100, 80, 40)})
    check_clear(laid_out(drawn, layout))


class Coded(Machine):
    A = State()
    B = State()

    @A.on_entry
    def _(self) -> None:
        """Do it."""
        # because
        text = "a # b"
        print(text)

    @A.on_exit
    def _(self) -> None: print("bye")  # fmt: skip

    A.to(B)


def texts(diagram: Diagram) -> dict[str, tuple[str, ...]]:
    return {section.name: section.lines for section in diagram.boxes[0].sections}


def test_sections_show_their_source() -> None:
    assert texts(arrange(Coded.table, sections=True)) == {
        "OnEntry": ("# because", 'text = "a # b"', "print(text)"),
        "OnExit": ('print("bye")  # fmt: skip',),
    }
    assert texts(arrange(Coded.table)) == {}


def test_a_lambda_shows_its_expression() -> None:
    state = State("A")
    state.on_entry(lambda machine: print("hello"))
    table = define("Short", [state]).table
    assert texts(arrange(table, sections=True)) == {"OnEntry": ('print("hello")',)}


def test_a_section_without_source_is_named() -> None:
    state = State("A")
    state.on_entry(eval("lambda machine: None"))
    table = define("Made", [state]).table
    assert texts(arrange(table, sections=True)) == {"OnEntry": ()}


def test_an_expanded_box_shows_what_fits() -> None:
    class Small(Coded):
        pass

    Small.table.layout = MachineLayout(
        {"A": StateBox(0, 0, 140, 90, True), "B": StateBox(0, 200, 9, 9)}
    )
    diagram = arrange(Small.table)
    assert (diagram.boxes[0].width, diagram.boxes[0].height) == (140, 90)
    assert texts(diagram) == {"OnEntry …": ("# because", 'text = "a # b"')}


def test_a_layout_without_room_for_all_the_code_is_left_aside() -> None:
    class Tight(Coded):
        pass

    Tight.table.layout = MachineLayout({"A": StateBox(0, 0, 90, 40), "B": StateBox(100, 0, 90, 40)})
    diagram = arrange(Tight.table, sections=True)
    check_clear(diagram)
    assert len(texts(diagram)["OnEntry"]) == 3
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert arrange(Tight.table).boxes[1].x == 100
