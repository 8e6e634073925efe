"""Shapes as SVG and PNG."""

from __future__ import annotations

import re
import sys
from io import BytesIO
from xml.etree import ElementTree as ET

import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image, ImageFont

from llfsm.runtime import DrawingError
from llfsm.runtime.drawing.curves import Point
from llfsm.runtime.drawing.png import SCALE, write_png
from llfsm.runtime.drawing.shapes import (
    Ellipse,
    Group,
    Line,
    Path,
    Picture,
    Polygon,
    Rectangle,
    Shape,
    Text,
)  # fmt: skip
from llfsm.runtime.drawing.svg import write_svg

SVG = "{http://www.w3.org/2000/svg}"
RED, BLUE, WHITE = "#dc141e", "#0a14c8", "#ffffff"


def pixels(*shapes: Shape, left: float = 0, top: float = 0) -> Image.Image:
    """Draw shapes into a picture of 40 by 30 units on blue."""
    picture = Picture("", 40, 30, BLUE, shapes, left, top)
    image = Image.open(BytesIO(write_png(picture))).convert("RGB")
    assert image.size == (40 * SCALE, 30 * SCALE)
    return image


def color_at(image: Image.Image, x: float, y: float) -> str:
    return "#{:02x}{:02x}{:02x}".format(*image.getpixel((round(x * SCALE), round(y * SCALE))))


@given(st.text())
def test_svg_holds_any_text(text: str) -> None:
    group = Group([Text(1, 2, text, 3, WHITE)], attributes={"data-name": text})
    root = ET.fromstring(write_svg(Picture(text, 10, 10, BLUE, [group])))
    readable = re.sub("[^\t\n\r -\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]", "\ufffd", text)
    readable = re.sub("\r\n?", "\n", readable)  # XML reads line ends so
    assert (root.find(f"{SVG}g/{SVG}text").text or "") == readable
    assert (root.find(f"{SVG}title").text or "") == readable
    assert root.find(f"{SVG}g").get("data-name").split() == readable.split()
    assert len(root) == 3


def test_markup_in_text_stays_text() -> None:
    hostile = "</text><script>alert('x')</script>&\"<"
    group = Group([Text(1, 2, hostile, 3, WHITE)], attributes={"class": hostile})
    assert "<script" not in write_svg(Picture(hostile, 10, 10, BLUE, [group]))


def test_numbers_are_short_and_exact() -> None:
    line = Line(((-0.001, 100), (0.5, -0.25)), RED, 1.0)
    svg = write_svg(Picture("", 10, 10, BLUE, [line, Ellipse(1.234, 20, 2.0, 1.0, RED)]))
    assert 'points="0,100 0.5,-0.25"' in svg
    assert 'cx="1.23" cy="20" rx="2" ry="1"' in svg


def test_groups_and_ellipses_are_turned() -> None:
    """An ellipse along y: turned by 30 degrees, in a group that is turned by 60."""
    members = [Ellipse(0, 0, 8, 2, RED, 30), Polygon([(8, -1), (10, 0), (8, 1)], WHITE)]
    group = Group(members, 20, 10, 60)
    image = pixels(group)
    assert color_at(image, 20, 16) == color_at(image, 20, 4) == RED
    assert color_at(image, 26, 10) == BLUE
    assert color_at(image, 24.3, 17.4) == WHITE  # the group's x axis points 60 degrees down
    assert 'transform="translate(20 10) rotate(60)"' in write_svg(Picture("", 9, 9, BLUE, [group]))


def test_each_shape_is_where_it_should_be() -> None:
    curve = (Point(5, 25), Point(5, 15), Point(15, 15), Point(15, 25))
    image = pixels(
        Rectangle(4, 4, 12, 6, 2, WHITE, RED, 2),
        Rectangle(24, 4, 12, 20, 0, BLUE, RED, 2, (4, 4)),
        Path(curve, WHITE, 2),
        Line([(20, 20), (20, 25)], RED, 4),
    )
    assert color_at(image, 10, 7) == WHITE
    assert color_at(image, 10, 4) == color_at(image, 16, 7) == RED
    assert color_at(image, 3.5, 3.5) == BLUE  # outside a round corner
    sides = {color_at(image, 36, y / 2) for y in range(12, 44)}
    assert {RED, BLUE} <= sides  # dashes
    assert color_at(image, 10, 17.5) == WHITE
    assert color_at(image, 20, 26) == RED  # the line's end is round
    assert color_at(image, 22, 27) == BLUE


def test_a_picture_may_begin_anywhere() -> None:
    image = pixels(Polygon([(-10, -5), (-6, -5), (-6, -1), (-10, -1)], RED), left=-12, top=-8)
    assert color_at(image, 4, 5) == RED
    assert color_at(image, 8, 10) == BLUE


def test_a_rim_surrounds_letters() -> None:
    plain, rimmed = (
        pixels(Text(20, 20, "I", 16, WHITE, rim=rim)).getcolors(100000) for rim in (None, RED)
    )
    red = (0xDC, 0x14, 0x1E)
    assert red not in [color for _, color in plain]
    assert red in [color for _, color in rimmed]


def test_text_that_no_font_can_draw_is_replaced() -> None:
    assert pixels(Text(20, 20, "\ud800\u202e\x00日\ue000", 9, WHITE)).getbbox()


def test_a_large_picture_is_drawn_at_its_own_size_and_a_larger_one_refused() -> None:
    data = write_png(Picture("", 8000, 6000, BLUE, []))
    with Image.open(BytesIO(data)) as image:
        assert image.size == (8000, 6000)
    with pytest.raises(DrawingError, match="8000 by 60000 would be too large: draw an SVG"):
        write_png(Picture("", 8000, 60000, BLUE, []))


def test_without_pillow_the_error_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "PIL", None)
    with pytest.raises(DrawingError, match=r"pip install 'llfsm\[draw\]'.*draw an SVG"):
        write_png(Picture("", 10, 10, BLUE, []))


def test_each_font_is_loaded_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """However many lines are written with it, in one picture or several."""
    loaded: list[float] = []
    load_default = ImageFont.load_default

    def load(size: float) -> object:
        loaded.append(size)
        return load_default(size)

    monkeypatch.setattr(ImageFont, "load_default", load)
    lines = [Text(5, 5, f"line {i}", 7.25 + i % 2, WHITE) for i in range(30)]  # no other test's
    picture = Picture("", 40, 30, BLUE, lines)
    assert write_png(picture) == write_png(picture)
    assert len(loaded) == len(set(loaded)) == 2
