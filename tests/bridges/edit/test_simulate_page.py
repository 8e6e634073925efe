"""What a simulated machine reads has fields, which show what it reads, in all windows."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from playwright.sync_api import Page, expect

from ..view.conftest import Visit, browser, visit  # noqa: F401
from .conftest import LAMP, made
from .test_edit_page import open_page  # noqa: F401

pytestmark = pytest.mark.timeout(240)

INCLUDES = """\
import enum
from typing import Annotated

from msgspec import Meta

from llfsm.runtime import Actuator, Sensor
from llfsm.whiteboard import Message, Slot


class Mode(enum.Enum):
    AUTO = "auto"
    HAND = "hand"


class Place(Message):
    x: float = 0.0
    y: float = 0.0


class Level(Message):
    value: float = 0.0
    on: bool = False
    mode: Mode = Mode.HAND
    share: Annotated[int, Meta(ge=0, le=9)] = 3
    place: Place = Place(x=1.5)
    three: tuple[float, float, float] = (0.0, 0.0, 0.0)
    pair: Annotated[tuple[int, ...], Meta(min_length=2, max_length=2)] = (1, 2)
    path: tuple[Place, ...] = ()
    name: str = "lamp"
"""


@pytest.fixture
def lamp(tmp_path: Path) -> Path:
    return made(tmp_path / "Lamp.machine", LAMP | {"Lamp_Includes.py": INCLUDES})


def press(page: Page, name: str) -> None:
    page.get_by_role("button", name=name, exact=True).click()


def number(page: Page, group: str, name: str) -> Page:
    return page.get_by_role("group", name=group).get_by_label(name).first  # type: ignore[return-value]


def test_fields_show_what_is_read(
    lamp: Path,
    open_page: Callable[[Path], Visit],  # noqa: F811
    visit: Callable[..., Visit],  # noqa: F811
) -> None:
    seen = open_page(lamp)
    page = seen.page
    press(page, "Simulate")
    page.get_by_label("mode").select_option(label="auto")
    page.get_by_label("share slider").fill("7")
    page.get_by_role("switch", name="on").click()
    number(page, "place", "y").fill("2.5")
    number(page, "three", "1").fill("-4")
    number(page, "pair", "0").fill("8")
    page.get_by_label("path").fill('[{"x": 1, "y": 2}]')
    page.get_by_label("name").fill("Lamp 2")
    page.get_by_label("value slider").fill("3")
    press(page, "Next state")
    expect(page.locator("#simulated")).to_contain_text("in On")

    # Another window shows the same, and fields that it sets are shown here.
    other = visit(page.url + "?token=secret").page
    expect(other.get_by_label("share").first).to_have_value("7")
    expect(other.get_by_label("mode")).to_have_value("0")
    expect(other.get_by_role("switch", name="on")).to_be_checked()
    expect(number(other, "three", "1")).to_have_value("-4")
    expect(number(other, "pair", "0")).to_have_value("8")
    expect(number(other, "place", "y")).to_have_value("2.5")
    expect(other.get_by_label("path")).to_have_value('[\n {\n  "x": 1,\n  "y": 2\n }\n]')
    other.get_by_role("switch", name="on").click()
    expect(page.get_by_role("switch", name="on")).not_to_be_checked()

    # After a reset nothing is posted any more: the fields are as the machine reads its sensor.
    press(page, "Reset")
    for window in (page, other):
        expect(window.locator("#simulated")).to_have_text("0.000 s, in Off")
        expect(window.get_by_label("share").first).to_have_value("3")
        expect(window.get_by_label("mode")).to_have_value("1")
        expect(window.get_by_label("name")).to_have_value("lamp")
    assert seen.errors == []
