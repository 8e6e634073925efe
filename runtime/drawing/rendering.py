"""A diagram as a picture, with each state and transition marked so that a page can light it."""

from __future__ import annotations

from collections.abc import Iterator

from llfsm.runtime.drawing import style
from llfsm.runtime.drawing.diagram import Box, Diagram, Edge, arrow_head
from llfsm.runtime.drawing.png import write_png
from llfsm.runtime.drawing.shapes import (
    Curve,
    Ellipse,
    FilledPolygon,
    Group,
    Path,
    Picture,
    Rectangle,
    Shape,
)
from llfsm.runtime.drawing.svg import write_svg
from llfsm.runtime.drawing.typeset import box_lines, label_lines, printable


def to_svg(diagram: Diagram) -> str:
    """Return a diagram as an SVG file's text.

    A state is a group of class ``state``, and ``initial``, ``accepting`` or ``suspend``, with its
    name as ``data-state``; a transition is one of class ``transition`` with ``data-transition``
    set to its state's name, a colon and its number from 0. Looks are attributes, not styles:
    a page's style sheet overrides them.
    """
    return write_svg(_picture(diagram))


def to_png(diagram: Diagram) -> bytes:
    """Return a diagram as a PNG file, two pixels to its unit, or one if it is very large.

    Raise `DrawingError` without Pillow, or for a diagram too large to draw.
    """
    return write_png(_picture(diagram))


def _picture(diagram: Diagram) -> Picture:
    shapes = [
        *(
            Group(
                [Ellipse(dot.x, dot.y, style.DOT, style.DOT, style.INK),
                 *_arrow(diagram.start, style.INK)],
                attributes={"class": "start"},
            )
            for dot in diagram.start[:1]
        ),
        *(_group(edge, _arrow(edge.curve, style.EDGE)) for edge in diagram.edges),
        *(_box(box) for box in diagram.boxes),
        *(_group(edge, _label(edge)) for edge in diagram.edges),
    ]  # fmt: skip
    return Picture(
        printable(diagram.title), diagram.width, diagram.height, style.BACKGROUND, shapes,
        diagram.left, diagram.top,
    )  # fmt: skip


def _group(edge: Edge, shapes: Iterator[Shape]) -> Group:
    marks = {
        "class": "transition",
        "data-transition": f"{printable(edge.source)}:{edge.number}",
        "data-target": printable(edge.target),
    }
    return Group([*shapes], attributes=marks)


def _arrow(curve: Curve, color: str) -> Iterator[Shape]:
    yield Path(curve, color, style.LINE)
    yield FilledPolygon(arrow_head(curve), color)


def _label(edge: Edge) -> Iterator[Shape]:
    label = edge.label
    left, top = label.x - label.width / 2, label.y - label.height / 2
    yield Rectangle(left, top, label.width, label.height, style.LABEL_CORNER, style.BACKGROUND)
    yield from label_lines(label)


def _box(box: Box) -> Group:
    marks = ("initial", box.initial), ("accepting", box.accepting), ("suspend", box.suspend)
    corner, fill = (box.height / 2, style.BACKGROUND) if box.slot else (style.CORNER, style.FILL)
    kinds = " ".join(["slot" if box.slot else "state", *(name for name, marked in marks if marked)])
    frames = [
        Rectangle(
            box.left + inset, box.top + inset, box.width - 2 * inset, box.height - 2 * inset,
            corner - inset / 2, fill, style.BORDER, style.LINE,
            style.DASH if box.suspend else None,
        )
        for inset in ((0.0, style.RIM) if box.accepting else (0.0,))
    ]  # fmt: skip
    attributes = {"class": kinds, "data-state": printable(box.state)}
    return Group([*frames, *box_lines(box)], attributes=attributes)
