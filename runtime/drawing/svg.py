"""Pictures as SVG: small, readable, and without a style sheet or font of their own."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from html import escape

from llfsm.runtime.drawing import shapes

_FACES = {
    "regular": "",
    "bold": ' font-weight="bold"',
    "code": " font-family=\"ui-monospace, Menlo, Consolas, 'DejaVu Sans Mono', monospace\""
    ' xml:space="preserve"',
}
_NOT_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def write_svg(picture: shapes.Picture) -> str:
    """Write a picture as the text of an SVG file. Its own text may hold any character."""
    x, y, width, height = map(_number, (picture.left, picture.top, picture.width, picture.height))
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}"'
        f' viewBox="{x} {y} {width} {height}" role="img"'
        ' font-family="Helvetica, Arial, sans-serif" text-anchor="middle">',
        f"<title>{_text(picture.title)}</title>",
        f'<rect class="background" x="{x}" y="{y}" width="{width}" height="{height}"'
        f' fill="{picture.background}"/>',
        *_elements(picture.shapes),
    ]
    return "\n".join([*lines, "</svg>", ""])


def _elements(drawn: Iterable[shapes.Shape]) -> Iterator[str]:
    for shape in drawn:
        match shape:
            case shapes.Line(points, color, width):
                yield (
                    f'<polyline points="{_points(points)}" fill="none" stroke="{color}"'
                    f' stroke-width="{_number(width)}" stroke-linecap="round"'
                    ' stroke-linejoin="round"/>'
                )
            case shapes.Path(curve, color, width):
                yield (
                    f'<path d="M{_points(curve[:1])} C{_points(curve[1:])}" fill="none"'
                    f' stroke="{color}" stroke-width="{_number(width)}"/>'
                )
            case shapes.Polygon(points, fill):
                yield f'<polygon points="{_points(points)}" fill="{fill}"/>'
            case shapes.Ellipse():
                yield _ellipse(shape)
            case shapes.Rectangle():
                yield _rectangle(shape)
            case shapes.Text():
                yield _label(shape)
            case shapes.Group(members, x, y, turn, attributes):
                marks = "".join(f' {name}="{_text(text)}"' for name, text in attributes.items())
                if x or y or turn:
                    moved = f"translate({_number(x)} {_number(y)}) rotate({_number(turn)})"
                    marks += f' transform="{moved}"'
                yield f"<g{marks}>"
                yield from _elements(members)
                yield "</g>"


def _ellipse(shape: shapes.Ellipse) -> str:
    x, y, rx, ry, turn = map(_number, (shape.x, shape.y, shape.rx, shape.ry, shape.turn))
    if rx == ry:
        return f'<circle cx="{x}" cy="{y}" r="{rx}" fill="{shape.fill}"/>'
    turned = f' transform="rotate({turn} {x} {y})"' if shape.turn else ""
    return f'<ellipse cx="{x}" cy="{y}" rx="{rx}" ry="{ry}" fill="{shape.fill}"{turned}/>'


def _rectangle(shape: shapes.Rectangle) -> str:
    x, y, width, height, corner = map(
        _number, (shape.left, shape.top, shape.width, shape.height, shape.corner)
    )
    border = ""
    if shape.stroke is not None:
        border = f' stroke="{shape.stroke}" stroke-width="{_number(shape.stroke_width)}"'
        if shape.dash is not None:
            border += f' stroke-dasharray="{" ".join(map(_number, shape.dash))}"'
    return (
        f'<rect x="{x}" y="{y}" width="{width}" height="{height}" rx="{corner}"'
        f' fill="{shape.fill}"{border}/>'
    )


def _label(shape: shapes.Text) -> str:
    x, y, size = map(_number, (shape.x, shape.y, shape.size))
    looks = _FACES[shape.face] + ("" if shape.centred else ' text-anchor="start"')
    if shape.rim is not None:
        looks += (
            f' stroke="{shape.rim}" stroke-width="{_number(shape.size / 4)}"'
            ' stroke-linejoin="round" paint-order="stroke"'
        )
    return (
        f'<text x="{x}" y="{y}" font-size="{size}" fill="{shape.color}"{looks}>'
        f"{_text(shape.text)}</text>"
    )


def _points(points: Iterable[tuple[float, float]]) -> str:
    return " ".join(f"{_number(x)},{_number(y)}" for x, y in points)


def _number(value: float) -> str:
    """Format a number to two decimals, without trailing zeros."""
    value = round(value, 2) + 0.0  # the sum makes 0 of -0
    return f"{value:.2f}".rstrip("0").rstrip(".")


def _text(text: str) -> str:
    """Escape text for SVG; what XML cannot hold at all becomes a replacement character."""
    return escape(_NOT_XML.sub("\ufffd", text))
