"""The page in a real browser: what it shows is what is on the board."""

from __future__ import annotations

import signal
from collections.abc import Callable
from typing import Any

import pytest
from playwright.sync_api import expect

from llfsm.whiteboard import Message, Slot, Whiteboard
from llfsm.whiteboard.messages.geometry_msgs import Twist, Vector3
from llfsm.whiteboard.messages.std_msgs import Bool
from llfsm.whiteboard.messages.turtlesim import Pose
from waiting import wait_for

from .conftest import Server

pytestmark = pytest.mark.timeout(240)


class Reading(Message):
    stamp: int
    volts: float
    name: str = ""
    parts: tuple[float, ...] = ()
    maybe: Bool | None = None


def test_a_slot_opens_to_its_value_and_its_schema(
    board: str, start: Callable[..., Any], visit: Callable[..., Any]
) -> None:
    slot = Slot("power/main", Reading)
    large = 1_800_000_000_123_456_789  # more than a double holds
    with Whiteboard(board) as wb:
        wb.add_message(slot, Reading(large, 12.625, "main", (1.0, float("nan")), Bool(True)))
        seen = visit(start(Server, board).address)
        page = seen.page
        row = page.locator("[data-slot='power/main']")
        row.locator(".line").click()
        for text in (str(large), "12.625", "main", "not a finite number", "true"):
            expect(row.locator(".tree").first).to_contain_text(text)
        expect(row.locator(".facts")).to_contain_text("1 added")
        wb.add_message(slot, Reading(2, 11.5, "spare"))
        expect(row.locator(".tree").first).to_contain_text("11.5")
        expect(row.locator(".tree").first).to_contain_text("empty")
        expect(row.locator(".facts")).to_contain_text("2 added")
        row.locator("button", has_text="Schema").click()
        expect(page.locator("#sheet pre")).to_contain_text('"title": "Reading"')
        page.keyboard.press("Escape")
        expect(row.locator("button", has_text="Post")).to_have_count(0)  # without --control
        assert seen.errors == []


def test_slots_are_filtered_and_pinned_with_the_keyboard(
    board: str, start: Callable[..., Any], visit: Callable[..., Any]
) -> None:
    with Whiteboard(board) as wb:
        for name in ("arm/left", "arm/right", "base/velocity"):
            wb.add_message(Slot(name, Twist), Twist())
        page = visit(start(Server, board).address).page
        names = page.locator("#rows .group:not(.own .group) .slot")
        expect(names).to_have_count(3)
        page.keyboard.press("/")
        page.keyboard.type("ARM twist")
        expect(names).to_have_count(2)
        expect(page.locator("#board-number")).to_have_text("2 of 3")
        page.locator("#board-filter").fill("nothing like it")
        expect(page.locator("#board-empty")).to_be_visible()
        page.locator("#board-filter").fill("")
        page.keyboard.press("Escape")
        page.locator("[data-slot='arm/left'] .line").focus()
        page.keyboard.press("ArrowDown")
        page.keyboard.press("ArrowDown")
        page.keyboard.press("p")
        expect(page.locator(".group.pinned .slot")).to_have_attribute("data-slot", "base/velocity")
        page.keyboard.press("Enter")
        expect(page.locator("[data-slot='base/velocity'] .tree").first).to_be_visible()
        page.reload()
        expect(page.locator(".group.pinned .slot")).to_have_count(1)
        page.keyboard.press("?")
        expect(page.locator("#keys")).to_be_visible()


def test_a_value_is_posted_with_a_form_made_of_the_schema(
    board: str, start: Callable[..., Any], visit: Callable[..., Any]
) -> None:
    slot = Slot("base/velocity", Twist)
    with Whiteboard(board) as wb:
        wb.add_message(slot, Twist(linear=Vector3(x=1.5)))
        seen = visit(start(Server, board, "--control").address)
        page = seen.page
        row = page.locator("[data-slot='base/velocity']")
        row.locator(".line").click()
        row.locator("button", has_text="Post").click()
        inputs = page.locator("#sheet input[type=number]")
        expect(inputs).to_have_count(6)
        expect(inputs.first).to_have_value("1.5")
        inputs.nth(5).fill("-0.25")
        page.locator("#sheet button", has_text="Post").click()
        wait_for(lambda: wb[slot].count == 2, "the message was posted")
        assert wb.get_message(slot) == Twist(linear=Vector3(x=1.5), angular=Vector3(z=-0.25))
        assert seen.errors == []


def test_the_page_comes_back_when_the_server_does(
    board: str, start: Callable[..., Any], visit: Callable[..., Any]
) -> None:
    slot = Slot("lamp", Bool)
    with Whiteboard(board) as wb:
        wb.add_message(slot, Bool(False))
        server = start(Server, board, LLFSM_VIEW_TOKEN="the same again")
        page = visit(server.address).page
        value = page.locator("[data-slot=lamp] .short")
        expect(value).to_have_text("data false")
        server.popen.send_signal(signal.SIGSTOP)
        expect(page.locator("#link")).to_have_attribute("data-is", "stalled")
        server.popen.send_signal(signal.SIGCONT)
        expect(page.locator("#link")).to_have_attribute("data-is", "live")
        server.end()
        expect(page.locator("#link")).to_have_attribute("data-is", "lost")
        expect(page.locator("#trouble")).to_be_visible()
        expect(value).to_have_text("data false")  # what was there last stays
        wb.add_message(slot, Bool(True))
        start(Server, board, port=server.port, LLFSM_VIEW_TOKEN="the same again")
        expect(page.locator("#link")).to_have_attribute("data-is", "live")
        expect(page.locator("#trouble")).to_be_hidden()
        expect(value).to_have_text("data true")


def test_a_board_may_come_go_and_come_again(
    board: str, start: Callable[..., Any], visit: Callable[..., Any]
) -> None:
    seen = visit(start(Server, board).address)
    page = seen.page
    expect(page.locator("#trouble")).to_contain_text("no whiteboard")
    with Whiteboard(board) as wb:
        wb.add_message(Slot("first", Bool), Bool(True))
        expect(page.locator("[data-slot=first] .short")).to_have_text("data true")
        expect(page.locator("#trouble")).to_be_hidden()
        wb.remove()
    expect(page.locator("#trouble")).to_contain_text("was removed")
    expect(page.locator("[data-slot=first]")).to_be_visible()
    with Whiteboard(board) as wb:
        wb.add_message(Slot("second", Pose), Pose(x=1.0))
        expect(page.locator("[data-slot=second] .short")).to_contain_text("x 1")
        expect(page.locator("[data-slot=first]")).to_have_count(0)
        expect(page.locator("#trouble")).to_be_hidden()
    assert seen.errors == []


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_the_theme_is_the_systems_until_it_is_chosen(
    board: str, start: Callable[..., Any], visit: Callable[..., Any], theme: str
) -> None:
    page = visit(start(Server, board).address, color_scheme=theme).page
    root = page.locator("html")
    expect(root).to_have_attribute("data-theme", theme)
    page.keyboard.press("t")
    other = "dark" if theme == "light" else "light"
    expect(root).to_have_attribute("data-theme", other)
    page.reload()
    expect(root).to_have_attribute("data-theme", other)


def test_names_are_cut_where_they_differ_least(
    board: str, start: Callable[..., Any], visit: Callable[..., Any]
) -> None:
    """On a telephone, what is left of the names still differs, and names their last part."""
    names = [
        f"{robot}/sensors/camera/{end}"
        for robot in ("robot1", "robot2")
        for end in ("depth", "image")
    ]
    names += [f"left_wheel_velocity_{end}_filtered" for end in ("command", "measured")]
    with Whiteboard(board) as wb:
        for name in names:
            wb.add_message(Slot(name, Bool), Bool())
        seen = visit(start(Server, board).address)
        seen.page.set_viewport_size({"width": 400, "height": 800})
        expect(seen.page.locator(".group.slots .whole")).to_have_count(len(names))
        shown = seen.page.locator(".group.slots .whole").evaluate_all(
            """each => each.map((name) => [...name.children].map((part) =>
                part.scrollWidth > part.clientWidth ? part.textContent.slice(0, 5) + "…"
                                                    : part.textContent).join(""))"""
        )
    assert len(set(shown)) == len(names)
    assert all("…" in name for name in shown)
    assert [name for name in shown if name.startswith("robot")] == [
        name for name in shown if name.endswith(("depth", "image"))
    ]
    assert seen.errors == []
