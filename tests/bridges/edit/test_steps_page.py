"""The drawing by keys and pointer: on to states and out again, steps, names, several states."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from playwright.sync_api import Page, expect

from llfsm.runtime.bundles import read_bundle
from llfsm.runtime.editing import Document, decode_edits
from llfsm.runtime.engine.table import StateBox
from waiting import wait_for

from ..view.conftest import Visit, browser, visit  # noqa: F401
from .test_edit_page import open_page, state  # noqa: F401

pytestmark = pytest.mark.timeout(240)
Open = Callable[[Path], Visit]


def focus(page: Page) -> None:
    page.locator("#drawing .diagram").focus()


def box(folder: Path, name: str) -> StateBox:
    layout = read_bundle(folder).layout
    assert layout is not None
    return layout.states[name]


def test_tab_goes_through_the_states_and_on(bundle: Path, open_page: Open) -> None:  # noqa: F811
    page = open_page(bundle).page
    place, drawing = page.locator("#place"), page.locator("#drawing .diagram")
    focus(page)
    for name in ("A", "B", "Lost"):
        page.keyboard.press("Tab")
        expect(place).to_have_text(name)
        expect(drawing).to_be_focused()
    page.keyboard.press("Tab")
    expect(page.locator("#findings .finding").first).to_be_focused()
    page.keyboard.press("Shift+Tab")
    expect(drawing).to_be_focused()
    page.keyboard.press("Escape")
    for name in ("Lost", "B", "A"):
        page.keyboard.press("Shift+Tab")
        expect(place).to_have_text(name)
    page.keyboard.press("Shift+Tab")
    expect(page.locator("#help")).to_be_focused()

    # All texts of what is selected, one after the other, and back to the drawing.
    focus(page)
    for name in (
        "Condition of transition 1 of A",
        "Condition of transition 2 of A",
        "OnEntry of A",
    ):
        page.keyboard.press("Control+Enter")
        expect(page.get_by_role("textbox", name=name)).to_be_focused()
    page.keyboard.press("Control+Shift+Enter")
    expect(page.get_by_role("textbox", name="Condition of transition 2 of A")).to_be_focused()
    page.keyboard.press("Escape")
    expect(drawing).to_be_focused()


def test_a_new_state_is_named_at_once(bundle: Path, open_page: Open) -> None:  # noqa: F811
    seen = open_page(bundle)
    page = seen.page
    focus(page)
    for name in ("First", "Second"):
        page.keyboard.press("n")
        expect(page.locator("#name")).to_be_focused()
        page.keyboard.type(name)
        page.keyboard.press("Enter")
        state(page, name).wait_for()
    wait_for(
        lambda: [each.name for each in read_bundle(bundle).states[3:]] == ["First", "Second"],
        "the names are written",
    )
    assert seen.errors == []


def test_states_are_resized_and_arrows_bent_by_keys(bundle: Path, open_page: Open) -> None:  # noqa: F811
    seen = open_page(bundle)
    page = seen.page
    focus(page)
    page.keyboard.press("Tab")
    page.keyboard.press("ArrowRight")
    wait_for(lambda: (bundle / "Layout.plist").exists(), "it is placed")
    width, height = box(bundle, "A").w, box(bundle, "A").h
    for _ in range(3):
        page.keyboard.press("Shift+ArrowRight")
    page.keyboard.press("Shift+ArrowDown")
    wait_for(
        lambda: (box(bundle, "A").w, box(bundle, "A").h) == (width + 30, height + 10),
        "the state is larger",
    )

    page.keyboard.press("]")
    expect(page.locator("#place")).to_have_text("A, transition 1")
    before = read_bundle(bundle).layout
    assert before is not None
    for _ in range(8):
        page.keyboard.press("ArrowRight")
    for _ in range(2):
        page.keyboard.press("Shift+ArrowDown")

    def bent() -> tuple[float, float]:
        layout = read_bundle(bundle).layout
        assert layout is not None
        path = layout.transitions["A"][0]
        return path.control1[0] - path.src[0], path.control2[0] - path.dst[0]

    wait_for(lambda: all(by > 50 for by in bent()), "the arrow is bent")
    assert seen.errors == []


def test_states_are_selected_together_and_one_by_one(bundle: Path, open_page: Open) -> None:  # noqa: F811
    page = open_page(bundle).page
    selected = page.locator("#drawing .state.selected")
    state(page, "A").click()
    state(page, "B").click(modifiers=["Control"])
    state(page, "Lost").click(modifiers=["Control"])
    expect(selected).to_have_count(3)
    state(page, "B").click(modifiers=["Control"])
    expect(selected).to_have_count(2)
    expect(page.locator("#place")).to_have_text("2 states")
    state(page, "A").click()
    expect(page.locator("#place")).to_have_text("A")
    expect(selected).to_have_count(1)


def test_what_is_new_or_selected_by_keys_is_in_sight(
    lamp: Path,
    bundle: Path,
    open_page: Open,  # noqa: F811
) -> None:
    document = Document(lamp)
    document.apply(decode_edits('[{"edit": "place states", "places": {"On": [4000, 3000]}}]'))
    seen = open_page(lamp)
    page = seen.page
    frame = page.locator("#drawing .diagram").bounding_box()
    assert frame is not None

    def is_in_sight(name: str) -> bool:
        box = state(page, name).locator(".box").bounding_box()
        return box is not None and (
            frame["x"] <= box["x"] <= frame["x"] + frame["width"] - box["width"]
            and frame["y"] <= box["y"] <= frame["y"] + frame["height"] - box["height"]
        )

    focus(page)
    for _ in range(12):
        page.keyboard.press("+")
    page.keyboard.press("Tab")
    wait_for(lambda: is_in_sight("Off"), "the first is in sight")
    page.keyboard.press("Tab")
    wait_for(lambda: is_in_sight("On") and not is_in_sight("Off"), "the next is in sight")

    # What is pasted elsewhere comes where one looks.
    page.keyboard.press("Control+c")
    page = open_page(bundle).page
    focus(page)
    page.keyboard.press("Control+v")
    wait_for(lambda: state(page, "On").count() == 1 and is_in_sight("On"), "it is in sight")
    assert seen.errors == []
