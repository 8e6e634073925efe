"""Diagrams of machines, and of arrangements: which boxes and arrows there are, and in which layout.

A machine's states stand where its editor's layout has them, or else in layers. The overview of an
arrangement has its machines, the slots that they share, and their requests.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple, TypeAlias

from llfsm.runtime.drawing.automatic_layout import automatic_layout
from llfsm.runtime.drawing.curves import Curve, Point, sample, straight
from llfsm.runtime.drawing.diagram import (
    Arrow,
    Box,
    Diagram,
    Edge,
    Label,
    cut_sections,
    make_box,
    make_label,
)
from llfsm.runtime.drawing.editor_layout import editor_layout, has_room, hits
from llfsm.runtime.drawing.style import DOT, LINE, MARGIN
from llfsm.runtime.drawing.typeset import RUNS, numbered_labels, section_texts
from llfsm.runtime.engine.machine import Machine
from llfsm.runtime.engine.ports import Actuator, Sensor
from llfsm.runtime.engine.state import State
from llfsm.runtime.engine.table import DrawnRuns, Table, run_by, run_names

_START = 26.0  # from the dot's centre to the initial state


Find: TypeAlias = Callable[[str], "Table | None"]
"""Finds the table of a machine that a state runs by its name."""


def arrange(
    table: Table,
    *,
    title: str | None = None,
    sections: bool | None = None,
    unfold: Find | None = None,
) -> Diagram:
    """Lay out a machine: find the positions of its states, transitions and labels.

    They are those of the table's layout if it has one; states and transitions that are missing
    there are placed around it. Without a layout, states are placed in layers below the initial one.

    `sections` shows or hides the states' sections. By default the layout decides which states show
    theirs, cut to the size of the box; without a layout they are hidden. True shows them in full,
    and ignores a layout that has no room for them. Equal tables give equal diagrams.

    `unfold` draws machines inside the states that run them, as far as they are known: it finds
    those that are only named. There the layout is ignored.
    """
    return _arranged(table, title, sections, unfold, (table,))


def _arranged(
    table: Table,
    title: str | None,
    sections: bool | None,
    unfold: Find | None,
    around: tuple[Table, ...],
) -> Diagram:
    """Lay out a machine inside those `around`, which are not drawn again in it."""
    boxes = [_box(state, table, sections, unfold, around) for state in table.states]
    index = {state.name: i for i, state in enumerate(table.states)}
    arrows = [
        Arrow(index[state.name], number, index[transition.target.name], make_label(label))
        for state in table.states
        for number, (transition, label) in enumerate(
            zip(state.transitions, numbered_labels(state), strict=True)
        )
    ]
    layout = table.layout
    known = layout is not None and not layout.states.keys().isdisjoint(index)
    unfolded = any(box.inner for box in boxes)
    if layout and known and not unfolded and (not sections or has_room(boxes, layout)):
        boxes, edges = editor_layout(boxes, arrows, layout)
    else:
        boxes, edges = automatic_layout(boxes, arrows)
    edges.sort(key=lambda edge: (index[edge.source], edge.number))
    start = _start(boxes[0], [*boxes[1:], *(edge.label for edge in edges)], edges)
    return framed(table.path if title is None else title, boxes, edges, start)


def _box(
    state: State,
    table: Table,
    sections: bool | None,
    unfold: Find | None,
    around: tuple[Table, ...],
) -> Box:
    given = table.layout.states.get(state.name) if table.layout else None
    inner, others = [], []
    for number, name in enumerate(run_names(state)):
        tables = [] if unfold is None else _tables(table, state, number, unfold)
        if tables and not any(each in around for _, each in tables):
            one_of = len(tables) > 1  # then `name` is of all
            for machine, each in tables:
                title = f"{RUNS} {each.path.rpartition(':')[2] if one_of else name}"
                drawn = _arranged(each, title, sections, unfold, (*around, each))
                inner.append(replace(drawn, machine=machine))
        else:
            others.append(name)
    texts = section_texts(state, sections=bool(sections), runs=others)
    if sections is None and given is not None and given.expanded:
        texts = section_texts(state, runs=others)
        if not inner:  # whose room no layout has
            texts = cut_sections(state.name, texts, given.w, given.h)
    return make_box(
        state.name,
        texts,
        tuple(inner),
        initial=state is table.initial,
        accepting=state.accepting,
        suspend=state is table.suspend,
        width=given.w if given else 0,
        height=given.h if given else 0,
    )


def _tables(table: Table, state: State, number: int, unfold: Find) -> list[tuple[str, Table]]:
    """List the tables of what a state may run, each after the name of its machine."""
    runs = state.runs[number]
    if isinstance(runs, DrawnRuns):
        return [*runs.tables]
    if isinstance(runs, str):
        found = unfold(runs)
        return [] if found is None else [(runs, found)]
    classes = run_by(runs)
    return [(table.inner_name(state, number, cls.__name__), cls.table) for cls in classes]


def _start(box: Box, others: Iterable[Box | Label], edges: Iterable[Edge]) -> Curve:
    """Draw the arrow to the initial state, at the side with the most room."""
    others, curves = list(others), [sample(edge.curve) for edge in edges]
    sides = [
        (Point(box.x, box.top - _START), Point(box.x, box.top)),
        (Point(box.left - _START, box.y), Point(box.left, box.y)),
        (Point(box.right + _START, box.y), Point(box.right, box.y)),
        (Point(box.x, box.bottom + _START), Point(box.x, box.bottom)),
    ]

    def clash(side: tuple[Point, Point]) -> int:
        dot, tip = side
        near = [Point((dot.x + tip.x) / 2, (dot.y + tip.y) / 2), dot]
        hit = sum(10 * hits(near, other, DOT + 4) for other in others)
        around = Label(near[0].x, near[0].y, 2 * DOT + 8, _START, ())
        return hit + sum(hits(points, around) for points in curves)

    return straight(*min(sides, key=clash))


def framed(title: str, boxes: list[Box], edges: list[Edge], start: Curve) -> Diagram:
    """Make a diagram with a frame around its boxes, labels and curves."""
    points = [point for edge in edges for point in sample(edge.curve)]
    dots = (Box("", dot.x, dot.y, 2 * DOT, 2 * DOT, ()) for dot in start[:1])
    items: list[Box | Label] = [*boxes, *(edge.label for edge in edges), *dots]
    x = [item.x + side * item.width / 2 for item in items for side in (-1, 1)]
    y = [item.y + side * item.height / 2 for item in items for side in (-1, 1)]
    x += (point.x for point in points)
    y += (point.y for point in points)
    left, top = min(x) - MARGIN - LINE, min(y) - MARGIN - LINE
    width, height = max(x) + MARGIN + LINE - left, max(y) + MARGIN + LINE - top
    return Diagram(title, left, top, width, height, tuple(boxes), tuple(edges), start)


class MachineLinks(NamedTuple):
    """The slots that a machine reads and posts, by name, and its requests to other machines.

    A request is what is asked, such as "suspend", and the name of the machine that is asked.
    """

    reads: Sequence[str] = ()
    posts: Sequence[str] = ()
    requests: Sequence[tuple[str, str]] = ()


def links_of(
    cls: type[Machine], slots: Mapping[str, str], requests: Sequence[tuple[str, str]]
) -> MachineLinks:
    """List the links of a machine that makes `requests` and is loaded with other `slots`."""

    def names(ports: Mapping[str, Sensor[Any, Any] | Actuator[Any]]) -> list[str]:
        return [slots.get(port.slot.name, port.slot.name) for port in ports.values()]

    return MachineLinks(names(cls.table.sensors), names(cls.table.actuators), requests)


def overview(title: str, machines: Mapping[str, MachineLinks]) -> Diagram:
    """Lay out machines and their slots: arrows lead where messages and requests go.

    A machine that is only asked, as one that others load, is drawn, too. Equal machines give equal
    diagrams.
    """
    asked = [name for each in machines.values() for _, name in each.requests]
    names = list(dict.fromkeys([*machines, *asked]))
    slots = list(dict.fromkeys(s for m in machines.values() for s in (*m.posts, *m.reads)))
    machine_at = {name: i for i, name in enumerate(names)}
    slot_at = {slot: len(names) + i for i, slot in enumerate(slots)}
    boxes = [make_box(name) for name in names]
    boxes += [make_box(slot, slot=True) for slot in slots]
    found: list[tuple[int, int, str]] = []
    for name, each in machines.items():
        here = machine_at[name]
        asks: dict[str, list[str]] = {}
        for what, other in each.requests:
            asks.setdefault(other, []).append(what)
        found += [(here, slot_at[slot], "posts") for slot in dict.fromkeys(each.posts)]
        found += [(slot_at[slot], here, "reads") for slot in dict.fromkeys(each.reads)]
        found += [
            (here, machine_at[other], ", ".join(dict.fromkeys(what)))
            for other, what in asks.items()
        ]
    numbers: Counter[int] = Counter()
    arrows = []
    for source, target, label in found:
        arrows.append(Arrow(source, numbers[source], target, make_label(label)))
        numbers[source] += 1
    placed, edges = automatic_layout(boxes, arrows)
    return framed(title, placed, edges, ())
