"""Shapes as SVG: small, readable, and without a style sheet or font of its own."""

import re
from collections.abc import Iterable, Iterator
from html import escape

from .pen import Color
from .shapes import Drawing, Ellipse, Group, Label, Line, Point, Polygon, Shape

__all__ = ["to_svg"]

_INHERITED = (
    'stroke-linecap="round" stroke-linejoin="round"'
    ' font-family="sans-serif" text-anchor="middle" paint-order="stroke"'
)
_NO_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def to_svg(drawing: Drawing) -> bytes:
    """Return a drawing as an SVG file in UTF-8; its text may hold any character."""
    width, height = _number(drawing.width), _number(drawing.height)
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}"'
        f' viewBox="0 0 {width} {height}" role="img" {_INHERITED}>',
        f"<title>{_text(drawing.title)}</title>",
        f'<rect width="{width}" height="{height}" fill="{_hex(drawing.background)}"/>',
        *_elements(drawing.shapes, ""),
        "</svg>",
    ]
    return ("\n".join(lines) + "\n").encode()


def _elements(shapes: Iterable[Shape], indent: str) -> Iterator[str]:
    for shape in shapes:
        match shape:
            case Line(points, color, width):
                yield (
                    f'{indent}<polyline points="{_points(points)}" fill="none"'
                    f' stroke="{_hex(color)}" stroke-width="{_number(width)}"/>'
                )
            case Polygon(points, fill):
                yield f'{indent}<polygon points="{_points(points)}" fill="{_hex(fill)}"/>'
            case Ellipse(x, y, rx, ry, fill, turn):
                turned = f' transform="{_rotate(turn, x, y)}"' if turn else ""
                yield (
                    f'{indent}<ellipse cx="{_number(x)}" cy="{_number(y)}" rx="{_number(rx)}"'
                    f' ry="{_number(ry)}" fill="{_hex(fill)}"{turned}/>'
                )
            case Label(x, y, text, size, color, rim):
                rimmed = f' stroke="{_hex(rim)}" stroke-width="{_number(size / 4)}"' if rim else ""
                yield (
                    f'{indent}<text x="{_number(x)}" y="{_number(y)}" font-size="{_number(size)}"'
                    f' fill="{_hex(color)}"{rimmed}>{_text(text)}</text>'
                )
            case Group(x, y, turn, members):
                moved = f"translate({_number(x)} {_number(y)})"
                yield f'{indent}<g transform="{moved} {_rotate(turn)}">'
                yield from _elements(members, indent + "  ")
                yield f"{indent}</g>"


def _points(points: Iterable[Point]) -> str:
    return " ".join(f"{_number(x)},{_number(y)}" for x, y in points)


def _rotate(turn: float, *about: float) -> str:
    return f"rotate({' '.join(map(_number, (turn, *about)))})"


def _number(value: float) -> str:
    """Write a number to a hundredth, without needless digits."""
    value = round(value, 2) + 0.0  # the sum makes 0 of -0
    return f"{value:.2f}".rstrip("0").rstrip(".")


def _hex(color: Color) -> str:
    return "#{:02x}{:02x}{:02x}".format(*color)


def _text(text: str) -> str:
    """Escape text for SVG; what XML cannot hold at all becomes a replacement character."""
    return escape(_NO_XML.sub("\ufffd", text))
