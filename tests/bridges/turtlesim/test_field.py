"""Pictures of the field: the shapes, and the files made of them."""

import io
import os
import sys
import xml.etree.ElementTree as ET

import pytest
from PIL import Image

from llfsm.bridges.turtlesim.canvas import Rgb
from llfsm.bridges.turtlesim.errors import TurtlesimError
from llfsm.bridges.turtlesim.field import draw, field_picture
from llfsm.runtime import DrawingError
from llfsm.runtime.drawing.png import SCALE, write_png
from llfsm.runtime.drawing.shapes import Group, Text
from llfsm.runtime.drawing.svg import write_svg

SVG = "{http://www.w3.org/2000/svg}"
RED, WHITE = Rgb(220, 20, 30), Rgb(255, 255, 255)


@pytest.fixture
def driven(simulator):
    """A field where turtle1 drew a red line from (2, 5) to the right, and bob stands still."""
    simulator.set_pen("turtle1", *RED, 5, off=True)
    simulator.teleport_absolute("turtle1", 2.0, 5.0, 0.0)
    simulator.step()
    simulator.set_pen("turtle1", *RED, 5)
    simulator.spawn(9.0, 9.0, 1.5, "bob")
    simulator.command("turtle1", 4.0, 0.0, 0.0)
    for _ in range(70):
        simulator.step()
    return simulator


def pixel(image, x, y):
    """The colour at a point of the field in metres, y up."""
    return image.getpixel((round(x * 45 * SCALE), round((499 / 45 - y) * 45 * SCALE)))


def opened(content):
    image = Image.open(io.BytesIO(content))
    assert image.format == "PNG"
    return image.convert("RGB")


def test_svg_shows_field_trail_turtles_and_caption(driven):
    root = ET.fromstring(write_svg(field_picture(driven, "A red line")))
    assert root.tag == f"{SVG}svg"
    assert root.get("viewBox") == "0 0 500 540"
    assert root.find(f"{SVG}title").text == "A red line"
    assert root.find(f"{SVG}rect").get("fill") == "#4556ff"
    (trail,) = root.findall(f"{SVG}polyline")
    assert (trail.get("stroke"), trail.get("stroke-width")) == ("#dc141e", "5")
    assert trail.get("points") == "90,274 271.44,274"
    bob, turtle1 = root.findall(f"{SVG}g")
    assert turtle1.get("transform") == "translate(271.44 274) rotate(0)"
    assert bob.get("transform") == "translate(405 94) rotate(-85.94)"
    texts = [text.text for text in root.findall(f"{SVG}text")]
    assert texts == ["bob", "turtle1", "A red line"]


def test_without_a_caption_there_is_no_band(driven):
    root = ET.fromstring(write_svg(field_picture(driven)))
    assert root.get("viewBox") == "0 0 500 500"
    assert root.find(f"{SVG}title").text == "turtlesim: bob, turtle1"


def test_png_has_the_trail_where_the_turtle_went(driven):
    image = opened(write_png(field_picture(driven)))
    assert image.size == (500 * SCALE, 500 * SCALE)
    for tenth in range(21, 50):
        assert pixel(image, tenth / 10, 5.0) == RED
    assert pixel(image, 3.0, 5.2) == (69, 86, 255)
    assert pixel(image, 7.5, 5.0) == (69, 86, 255)
    for turtle in driven.turtles.values():
        assert pixel(image, turtle.pose.x, turtle.pose.y) not in {(69, 86, 255), RED}


def test_both_formats_follow_the_background(driven):
    driven.parameters.set("background_r", 1)
    driven.parameters.set("background_g", 2)
    driven.parameters.set("background_b", 3)
    assert opened(write_png(field_picture(driven))).getpixel((5, 5)) == (1, 2, 3)
    assert (
        ET.fromstring(write_svg(field_picture(driven))).find(f"{SVG}rect").get("fill") == "#010203"
    )


def test_a_long_caption_is_broken_into_lines_that_fit(driven):
    caption = "word " * 30
    picture = field_picture(driven, caption)
    lines = [s.text for s in picture.shapes if isinstance(s, Text) and s.y > 500]
    assert " ".join(lines) == caption.strip()
    assert max(map(len, lines)) <= 56
    assert picture.height == 500 + 20 * (len(lines) + 1)
    assert opened(write_png(picture)).getpixel((5, 1005)) == WHITE


def test_a_turtle_just_spawned_far_outside_is_drawn_at_the_edge(simulator):
    simulator.spawn(1e38, -1e38, 0.0, "far")
    picture = field_picture(simulator)
    far = next(shape for shape in picture.shapes if isinstance(shape, Group))
    assert (far.x, far.y) == pytest.approx((499, 499))
    opened(write_png(picture))


def test_draw_writes_what_the_ending_says(driven, tmp_path):
    assert draw(driven, tmp_path / "a.svg") == (tmp_path / "a.svg",)
    assert draw(driven, str(tmp_path / "b.PNG")) == (tmp_path / "b.PNG",)
    both = draw(driven, tmp_path / "new" / "c", "caption")
    assert both == (tmp_path / "new" / "c.svg", tmp_path / "new" / "c.png")
    assert (tmp_path / "a.svg").read_text() == write_svg(field_picture(driven))
    assert opened((tmp_path / "b.PNG").read_bytes()).size == (1000, 1000)
    assert sorted(p.name for p in tmp_path.rglob("*")) == [
        "a.svg",
        "b.PNG",
        "c.png",
        "c.svg",
        "new",
    ]


def test_an_unknown_ending_is_an_error(driven, tmp_path):
    with pytest.raises(TurtlesimError, match=r"its ending is '\.gif', and must be \.svg or"):
        draw(driven, tmp_path / "a.gif")
    assert list(tmp_path.iterdir()) == []


def test_a_path_without_a_name_is_an_error(driven):
    with pytest.raises(TurtlesimError, match="it names a folder, not a file"):
        draw(driven, "")


def test_a_failed_replacement_leaves_the_old_file(driven, tmp_path, monkeypatch):
    def fail(source, target):
        assert source.read_text() == write_svg(field_picture(driven))  # complete before the move
        raise PermissionError(13, "no", target)

    path = tmp_path / "a.svg"
    path.write_text("old")
    monkeypatch.setattr(os, "replace", fail)
    with pytest.raises(PermissionError):
        draw(driven, path)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_folder_that_cannot_be_made_is_an_os_error(driven, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(OSError, match="file"):
        draw(driven, tmp_path / "file" / "a.svg")


def test_png_without_pillow_names_the_extra(driven, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "PIL", None)
    with pytest.raises(DrawingError, match=r"pip install 'llfsm\[draw\]'"):
        draw(driven, tmp_path / "a.png")
    draw(driven, tmp_path / "a.svg")
    assert [p.name for p in tmp_path.iterdir()] == ["a.svg"]
