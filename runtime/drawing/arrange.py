"""From a machine's table to its picture's geometry."""

from __future__ import annotations

from collections.abc import Iterable

from ..engine.state import State
from ..engine.table import Table
from .automatic_layout import automatic_layout
from .curves import hits, sample, straight
from .diagram import Arrow, Box, Diagram, Edge, Label, SectionText
from .editor_layout import editor_layout, has_room
from .shapes import Curve, PicturePoint
from .style import DOT, LINE, MARGIN
from .text import numbered_labels, section_texts
from .typeset import cut_sections, make_box, make_label

__all__ = ["arrange", "framed"]

_START = 26.0  # from the dot's centre to the initial state


def arrange(table: Table, *, title: str | None = None, sections: bool | None = None) -> Diagram:
    """Return the positions of a machine's states, transitions and labels.

    They are those of the table's layout if it has one; states and transitions that are missing
    there are placed around it. Without a layout, states are placed in layers below the initial one.

    `sections` shows or hides the states' sections. By default the layout decides which states show
    theirs, cut to the size of the box; without a layout they are hidden. True shows them in full,
    and ignores a layout that has no room for them. Equal tables give equal diagrams.
    """
    boxes = [_box(state, table, sections) for state in table.states]
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
    if layout and known and (not sections or has_room(boxes, layout)):
        boxes, edges = editor_layout(boxes, arrows, layout)
    else:
        boxes, edges = automatic_layout(boxes, arrows)
    edges.sort(key=lambda edge: (index[edge.source], edge.number))
    start = _start(boxes[0], [*boxes[1:], *(edge.label for edge in edges)], edges)
    return framed(table.path if title is None else title, boxes, edges, start)


def _box(state: State, table: Table, sections: bool | None) -> Box:
    given = table.layout.states.get(state.name) if table.layout else None
    texts: tuple[SectionText, ...] = ()
    if sections:
        texts = section_texts(state)
    elif sections is None and given is not None and given.expanded:
        texts = cut_sections(state.name, section_texts(state), given.w, given.h)
    return make_box(
        state.name,
        texts,
        initial=state is table.initial,
        accepting=not state.transitions,
        suspend=state is table.suspend,
        width=given.w if given else 0,
        height=given.h if given else 0,
    )


def _start(box: Box, others: Iterable[Box | Label], edges: Iterable[Edge]) -> Curve:
    """Return the arrow to the initial state, at the side with the most room."""
    others, curves = list(others), [sample(edge.curve) for edge in edges]
    sides = [
        (PicturePoint(box.x, box.top - _START), PicturePoint(box.x, box.top)),
        (PicturePoint(box.left - _START, box.y), PicturePoint(box.left, box.y)),
        (PicturePoint(box.right + _START, box.y), PicturePoint(box.right, box.y)),
        (PicturePoint(box.x, box.bottom + _START), PicturePoint(box.x, box.bottom)),
    ]

    def clash(side: tuple[PicturePoint, PicturePoint]) -> int:
        dot, tip = side
        near = [PicturePoint((dot.x + tip.x) / 2, (dot.y + tip.y) / 2), dot]
        hit = sum(10 * hits(near, other, DOT + 4) for other in others)
        around = Label(near[0].x, near[0].y, 2 * DOT + 8, _START, ())
        return hit + sum(hits(points, around) for points in curves)

    return straight(*min(sides, key=clash))


def framed(title: str, boxes: list[Box], edges: list[Edge], start: Curve) -> Diagram:
    """Return the diagram with a frame around all that is in it."""
    x = [point.x + side for point in start[:1] for side in (-DOT, DOT)]
    y = [point.y + side for point in start[:1] for side in (-DOT, DOT)]
    items: list[Box | Label] = [*boxes, *(edge.label for edge in edges)]
    for item in items:
        x += item.x - item.width / 2, item.x + item.width / 2
        y += item.y - item.height / 2, item.y + item.height / 2
    for edge in edges:
        points = sample(edge.curve)
        x += (point.x for point in points)
        y += (point.y for point in points)
    left, top = min(x) - MARGIN - LINE, min(y) - MARGIN - LINE
    width, height = max(x) + MARGIN + LINE - left, max(y) + MARGIN + LINE - top
    return Diagram(title, left, top, width, height, tuple(boxes), tuple(edges), start)
