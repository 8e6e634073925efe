"""A diagram as SVG, each state and transition marked so that a page can light it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from html import escape

from . import style
from .diagram import Box, Curve, Diagram, Edge, Point, arrow_head
from .text import printable
from .typeset import TextLine, box_lines, label_lines

__all__ = ["to_svg"]

_SANS = 'font-family="Helvetica, Arial, sans-serif"'
_FACES = {
    "regular": "",
    "bold": ' font-weight="bold"',
    "code": " font-family=\"ui-monospace, Menlo, Consolas, 'DejaVu Sans Mono', monospace\""
    ' xml:space="preserve"',
}


def to_svg(diagram: Diagram) -> str:
    """Return a diagram as an SVG file's text.

    A state is a group of class ``state``, and ``initial``, ``accepting`` or ``suspend``, with its
    name as ``data-state``; a transition is one of class ``transition`` with ``data-transition``
    set to its state's name, a colon and its number from 0. Looks are attributes, not styles:
    a page's style sheet overrides them.
    """
    frame = " ".join(
        _number(value) for value in (diagram.left, diagram.top, diagram.width, diagram.height)
    )
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{_number(diagram.width)}"'
        f' height="{_number(diagram.height)}" viewBox="{frame}" role="img"'
        f' {_SANS} text-anchor="middle">',
        f"<title>{_text(diagram.title)}</title>",
        f'<rect class="background" x="{_number(diagram.left)}" y="{_number(diagram.top)}"'
        f' width="{_number(diagram.width)}" height="{_number(diagram.height)}"'
        f' fill="{style.BACKGROUND}"/>',
        *_start(diagram.start),
    ]
    for edge in diagram.edges:
        lines += _edge(edge)
    for box in diagram.boxes:
        lines += _box(box)
    for edge in diagram.edges:
        lines += _label(edge)
    return "\n".join([*lines, "</svg>", ""])


def _start(curve: Curve) -> Iterator[str]:
    yield '<g class="start">'
    yield (
        f'<circle cx="{_number(curve[0].x)}" cy="{_number(curve[0].y)}"'
        f' r="{_number(style.DOT)}" fill="{style.INK}"/>'
    )
    yield from _arrow(curve, style.INK)
    yield "</g>"


def _edge(edge: Edge) -> Iterator[str]:
    yield f"<g {_mark(edge)}>"
    yield from _arrow(edge.curve, style.EDGE)
    yield "</g>"


def _mark(edge: Edge) -> str:
    return (
        f'class="transition" data-transition="{_text(edge.source)}:{edge.number}"'
        f' data-target="{_text(edge.target)}"'
    )


def _arrow(curve: Curve, color: str) -> Iterator[str]:
    start, *rest = (_point(point) for point in curve)
    head = " ".join(_point(point) for point in arrow_head(curve))
    yield (
        f'<path d="M{start} C{" ".join(rest)}" fill="none" stroke="{color}"'
        f' stroke-width="{_number(style.LINE)}"/>'
    )
    yield f'<polygon points="{head}" fill="{color}"/>'


def _label(edge: Edge) -> Iterator[str]:
    label = edge.label
    yield f"<g {_mark(edge)}>"
    yield (
        f'<rect x="{_number(label.x - label.width / 2)}" y="{_number(label.y - label.height / 2)}"'
        f' width="{_number(label.width)}" height="{_number(label.height)}"'
        f' rx="4" fill="{style.BACKGROUND}"/>'
    )
    yield from _lines(label_lines(label))
    yield "</g>"


def _box(box: Box) -> Iterator[str]:
    marks = ("initial", box.initial), ("accepting", box.accepting), ("suspend", box.suspend)
    kinds = " ".join(["state", *(name for name, marked in marks if marked)])
    yield f'<g class="{kinds}" data-state="{_text(box.state)}">'
    dash = f' stroke-dasharray="{" ".join(map(_number, style.DASH))}"' if box.suspend else ""
    for inset in (0, style.RIM) if box.accepting else (0,):
        yield (
            f'<rect x="{_number(box.left + inset)}" y="{_number(box.top + inset)}"'
            f' width="{_number(box.width - 2 * inset)}"'
            f' height="{_number(box.height - 2 * inset)}" rx="{_number(style.CORNER - inset / 2)}"'
            f' fill="{style.FILL}" stroke="{style.BORDER}"'
            f' stroke-width="{_number(style.LINE)}"{dash}/>'
        )
    yield from _lines(box_lines(box))
    yield "</g>"


def _lines(lines: Iterable[TextLine]) -> Iterator[str]:
    for line in lines:
        anchor = "" if line.centred else ' text-anchor="start"'
        yield (
            f'<text x="{_number(line.x)}" y="{_number(line.y)}" font-size="{_number(line.size)}"'
            f' fill="{line.color}"{_FACES[line.face]}{anchor}>{_text(line.text)}</text>'
        )


def _point(point: Point) -> str:
    return f"{_number(point.x)},{_number(point.y)}"


def _number(value: float) -> str:
    """Write a number to a hundredth, without needless digits."""
    value = round(value, 2) + 0.0  # the sum makes 0 of -0
    return f"{value:.2f}".rstrip("0").rstrip(".")


def _text(text: str) -> str:
    return escape(printable(text))
