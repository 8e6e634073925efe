"""Diagrams: states as boxes, transitions as curves with labels, all with their places.

A `Diagram` is plain geometry for any writer: the page draws it itself, and here it becomes a
`Picture` of flat shapes, in which each state and transition is marked so that a page can light it.
Boxes and labels are made as large as their text needs, and then placed by a layout. Lengths are in
units of the picture, x to the right and y down; a curve ends at the tip of its arrow.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import hypot
from typing import NamedTuple

from llfsm.runtime.drawing import shapes, style
from llfsm.runtime.drawing.curves import Curve, Point
from llfsm.runtime.drawing.png import write_png
from llfsm.runtime.drawing.svg import write_svg
from llfsm.runtime.drawing.typeset import (
    SectionText,
    code_width,
    line_height,
    printable,
    text_width,
    wrap,
)

HEAD = 9.0
"""The length of an arrow's head."""

_PADDING = 12.0  # beside the text of a box
_ABOVE = 9.0  # above and below a title on its own
_ABOVE_SECTIONS = 7.0  # above a title with sections, and below these
_HEADING = 4.0 + line_height(style.HEADING_SIZE)
_CUT = " …"
_BASELINE = 0.35  # of a size below the middle of a line


@dataclass(frozen=True, slots=True)
class Box:
    """A state around its centre (x, y), with the sections that are shown.

    `inner` are the diagrams of the machines that it runs, if they are drawn in it, side by side.
    In an overview, it is a machine or, with `slot`, a slot.
    """

    state: str
    x: float
    y: float
    width: float
    height: float
    title: tuple[str, ...]
    sections: tuple[SectionText, ...] = ()
    initial: bool = False
    accepting: bool = False
    suspend: bool = False
    slot: bool = False
    inner: tuple[Diagram, ...] = ()

    @property
    def left(self) -> float:
        """Return the left side's x."""
        return self.x - self.width / 2

    @property
    def right(self) -> float:
        """Return the right side's x."""
        return self.x + self.width / 2

    @property
    def top(self) -> float:
        """Return the upper side's y."""
        return self.y - self.height / 2

    @property
    def bottom(self) -> float:
        """Return the lower side's y."""
        return self.y + self.height / 2


@dataclass(frozen=True, slots=True)
class Label:
    """Lines of text around their centre (x, y)."""

    x: float
    y: float
    width: float
    height: float
    lines: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Edge:
    """Transition `number` (from 0) of state `source`."""

    source: str
    number: int
    target: str
    curve: Curve
    label: Label


class Arrow(NamedTuple):
    """A transition without a curve yet; source and target are indices into the list of boxes."""

    source: int
    number: int
    target: int
    label: Label

    def edge(self, boxes: Sequence[Box], curve: Curve, label: Label) -> Edge:
        """Draw it along `curve`, with its label in its place."""
        return Edge(boxes[self.source].state, self.number, boxes[self.target].state, curve, label)


@dataclass(frozen=True, slots=True)
class Diagram:
    """A machine's picture; (left, top) need not be (0, 0), for places that an editor chose.

    `start` is the arrow to the initial state; its first point is the centre of a dot. That of an
    overview is empty. One inside a box has the name of its `machine`, without that of the outer
    one. A notebook shows the diagram.
    """

    title: str
    left: float
    top: float
    width: float
    height: float
    boxes: tuple[Box, ...]
    edges: tuple[Edge, ...]
    start: Curve
    machine: str = ""

    def _repr_svg_(self) -> str:
        return to_svg(self)


# Boxes and labels as large as their text


def make_label(text: str) -> Label:
    """Make a label of some text, at (0, 0) and as large as it needs."""
    lines = wrap(text)
    width = max(text_width(line, style.LABEL_SIZE) for line in lines)
    return Label(0, 0, width + 8, len(lines) * line_height(style.LABEL_SIZE) + 2, lines)


def make_box(
    state: str,
    sections: tuple[SectionText, ...] = (),
    inner: tuple[Diagram, ...] = (),
    /,
    *,
    width: float = 0,
    height: float = 0,
    **kinds: bool,
) -> Box:
    """Make the box of a state, at (0, 0): at least as large as asked and as what is in it needs."""
    title = wrap(state)
    widths = [text_width(line, style.TITLE_SIZE) * style.BOLD for line in title]
    needed = _title_height(title) + 2 * (_ABOVE_SECTIONS if sections or inner else _ABOVE)
    for section in sections:
        widths.append(text_width(section.name, style.HEADING_SIZE) * style.BOLD)
        widths += [code_width(line, style.CODE_SIZE) for line in section.lines]
        needed += _HEADING + len(section.lines) * line_height(style.CODE_SIZE)
    if inner:
        widths.append(sum(map(_inner_width, inner)))
        needed += _HEADING + max(each.height for each in inner)
    width, height = max(width, max(widths) + 2 * _PADDING), max(height, needed)
    return Box(state, 0, 0, width, height, title, sections, inner=inner, **kinds)


def cut_sections(
    state: str, sections: tuple[SectionText, ...], width: float, height: float
) -> tuple[SectionText, ...]:
    """Cut a state's sections to the size of its box; an ellipsis stands for the rest."""
    letters = max(int((width - 2 * _PADDING) / code_width("m", style.CODE_SIZE)), 1)
    room = height - _title_height(wrap(state)) - 2 * _ABOVE_SECTIONS
    kept: list[SectionText] = []
    for section in sections:
        room -= _HEADING
        if room < 0:
            if kept:
                kept[-1] = kept[-1]._replace(name=f"{kept[-1].name.removesuffix(_CUT)}{_CUT}")
            break
        lines = [
            line if len(line) <= letters else f"{line[: letters - 1]}…" for line in section.lines
        ]
        shown = tuple(lines[: int(room / line_height(style.CODE_SIZE))])
        room -= len(shown) * line_height(style.CODE_SIZE)
        kept.append(SectionText(section.name + _CUT * (len(shown) < len(lines)), shown))
    return tuple(kept)


def box_lines(box: Box) -> Iterator[shapes.Text]:
    """Yield the lines of a box: its title, in the middle or above the sections, and these."""
    is_full = box.sections or box.inner
    y = box.top + _ABOVE_SECTIONS if is_full else box.y - _title_height(box.title) / 2
    for line in box.title:
        y += line_height(style.TITLE_SIZE)
        base = y - line_height(style.TITLE_SIZE) / 2 + _BASELINE * style.TITLE_SIZE
        yield shapes.Text(box.x, base, line, style.TITLE_SIZE, style.INK, "bold", True)
    x = box.left + _PADDING
    for section in box.sections:
        y += _HEADING
        base = y - _BASELINE * style.HEADING_SIZE
        yield shapes.Text(x, base, section.name, style.HEADING_SIZE, style.ACCENT, "bold", False)
        for line in section.lines:
            y += line_height(style.CODE_SIZE)
            base = y - _BASELINE * style.CODE_SIZE
            yield shapes.Text(x, base, line, style.CODE_SIZE, style.CODE, "code", False)
    y += _HEADING
    base = y - _BASELINE * style.HEADING_SIZE
    for each, x, _ in inner_places(box):
        yield shapes.Text(x, base, each.title, style.HEADING_SIZE, style.ACCENT, "bold", False)


def label_lines(label: Label) -> Iterator[shapes.Text]:
    """Yield the lines of a label, from the top."""
    size = style.LABEL_SIZE
    y = label.y - (len(label.lines) - 1) / 2 * line_height(size) + _BASELINE * size
    for line in label.lines:
        yield shapes.Text(label.x, y, line, size, style.LABEL, "regular", True)
        y += line_height(size)


def inner_places(box: Box) -> Iterator[tuple[Diagram, float, float]]:
    """Yield each diagram of a box, with x of its left side and y of its upper one."""
    x = box.x - sum(map(_inner_width, box.inner)) / 2
    y = box.bottom - _ABOVE_SECTIONS - max((each.height for each in box.inner), default=0)
    for each in box.inner:
        yield each, x, y
        x += _inner_width(each)


def _inner_width(diagram: Diagram) -> float:
    title = text_width(diagram.title, style.HEADING_SIZE) * style.BOLD
    return max(diagram.width, title + _PADDING)


def _title_height(title: tuple[str, ...]) -> float:
    return len(title) * line_height(style.TITLE_SIZE)


# The diagram as a picture


def to_svg(diagram: Diagram) -> str:
    """Write a diagram as the text of an SVG file.

    A state is a group of class ``state``, and ``initial``, ``accepting`` or ``suspend``, with its
    name as ``data-state``; a transition is one of class ``transition`` with ``data-transition``
    set to its state's name, a colon and its number from 0. Looks are attributes, not styles:
    a page's style sheet overrides them.
    """
    return write_svg(_picture(diagram))


def to_png(diagram: Diagram) -> bytes:
    """Write a diagram as a PNG file, two pixels to its unit, or one if it is very large.

    Raise `DrawingError` without Pillow, or for a diagram too large to draw.
    """
    return write_png(_picture(diagram))


def _picture(diagram: Diagram) -> shapes.Picture:
    return shapes.Picture(
        printable(diagram.title), diagram.width, diagram.height, style.BACKGROUND,
        _drawn(diagram), diagram.left, diagram.top,
    )  # fmt: skip


def _drawn(diagram: Diagram) -> list[shapes.Shape]:
    return [
        *(
            shapes.Group(
                [shapes.Ellipse(dot.x, dot.y, style.DOT, style.DOT, style.INK),
                 *_arrow(diagram.start, style.INK)],
                attributes={"class": "start"},
            )
            for dot in diagram.start[:1]
        ),
        *(_group(edge, _arrow(edge.curve, style.EDGE)) for edge in diagram.edges),
        *(_box(box) for box in diagram.boxes),
        *(_group(edge, _label(edge)) for edge in diagram.edges),
    ]  # fmt: skip


def _group(edge: Edge, drawn: Iterator[shapes.Shape]) -> shapes.Group:
    marks = {
        "class": "transition",
        "data-transition": f"{printable(edge.source)}:{edge.number}",
        "data-target": printable(edge.target),
    }
    return shapes.Group([*drawn], attributes=marks)


def _arrow(curve: Curve, color: str) -> Iterator[shapes.Shape]:
    yield shapes.Path(curve, color, style.LINE)
    yield shapes.Polygon(arrow_head(curve), color)


def _label(edge: Edge) -> Iterator[shapes.Shape]:
    label = edge.label
    left, top = label.x - label.width / 2, label.y - label.height / 2
    yield shapes.Rectangle(
        left, top, label.width, label.height, style.LABEL_CORNER, style.BACKGROUND
    )
    yield from label_lines(label)


def _box(box: Box) -> shapes.Group:
    marks = ("initial", box.initial), ("accepting", box.accepting), ("suspend", box.suspend)
    corner, fill = (box.height / 2, style.BACKGROUND) if box.slot else (style.CORNER, style.FILL)
    kinds = " ".join(["slot" if box.slot else "state", *(name for name, marked in marks if marked)])
    frames = [
        shapes.Rectangle(
            box.left + inset, box.top + inset, box.width - 2 * inset, box.height - 2 * inset,
            corner - inset / 2, fill, style.BORDER, style.LINE,
            style.DASH if box.suspend else None,
        )
        for inset in ((0.0, style.RIM) if box.accepting else (0.0,))
    ]  # fmt: skip
    attributes = {"class": kinds, "data-state": printable(box.state)}
    return shapes.Group([*frames, *box_lines(box), *_inner(box)], attributes=attributes)


def _inner(box: Box) -> Iterator[shapes.Group]:
    """Yield what a box has of other machines, at the bottom of it."""
    for each, x, y in inner_places(box):
        marks = {"class": "inner", "data-machine": printable(each.title)}
        yield shapes.Group(_drawn(each), x - each.left, y - each.top, attributes=marks)


def arrow_head(curve: Curve) -> tuple[Point, Point, Point]:
    """Return the triangle at the end of a curve, its tip first."""
    tip = curve[-1]
    before = next((p for p in reversed(curve) if p != tip), Point(tip.x, tip.y - 1))
    length = hypot(tip.x - before.x, tip.y - before.y)
    dx, dy = (tip.x - before.x) / length, (tip.y - before.y) / length
    base = Point(tip.x - HEAD * dx, tip.y - HEAD * dy)
    side = HEAD * 0.38
    return (
        tip,
        Point(base.x - side * dy, base.y + side * dx),
        Point(base.x + side * dy, base.y - side * dx),
    )
