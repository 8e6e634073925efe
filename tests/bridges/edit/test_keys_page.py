"""The editor by keys: lists of states, free room for new ones, undo of a hundred steps."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from playwright.sync_api import expect

from llfsm.runtime.bundles import read_bundle
from llfsm.runtime.editing import Document
from llfsm.runtime.editing._state_edits import AddState
from waiting import wait_for

from ..view.conftest import Visit, browser, visit  # noqa: F401
from .test_edit_page import files_of, open_page, state  # noqa: F401

pytestmark = pytest.mark.timeout(240)

OVERLAPS = """() => {
  const drawn = [...document.querySelectorAll("#drawing .state .box")];
  const boxes = drawn.map((box) => box.getBoundingClientRect());
  const cover = (a, b) =>
    a.left < b.right && b.left < a.right && a.top < b.bottom && b.top < a.bottom;
  return boxes.filter((a, i) => boxes.some((b, j) => i < j && cover(a, b))).length;
}"""


def test_a_target_is_chosen_by_keys(
    bundle: Path,
    open_page: Callable[[Path], Visit],  # noqa: F811
) -> None:
    seen = open_page(bundle)
    page = seen.page
    labels = page.locator("[data-transition].label")
    expect(labels).to_have_count(2)

    # On the way to a state in the list, no transition is made to those before it.
    state(page, "B").click()
    page.keyboard.press("c")
    for _ in range(3):
        page.keyboard.press("ArrowDown")
    expect(page.locator("#connect")).to_have_value("Lost")
    page.keyboard.press("Enter")
    expect(page.locator("[data-transition='B:0'].label")).to_be_visible()
    expect(labels).to_have_count(3)
    wait_for(
        lambda: [t.target for t in read_bundle(bundle).states[1].transitions] == ["Lost"],
        "the transition is written",
    )

    # The same of the target of a transition; leaving the list takes the choice back.
    target = page.locator("[data-row='B:0'] select")
    target.focus()
    page.keyboard.type("A")
    expect(target).to_have_value("A")
    page.keyboard.press("Escape")
    expect(target).to_have_value("Lost")
    target.focus()
    page.keyboard.type("A")
    page.keyboard.press("Enter")
    wait_for(
        lambda: [t.target for t in read_bundle(bundle).states[1].transitions] == ["A"],
        "the transition leads elsewhere",
    )
    assert seen.errors == []


def test_new_states_cover_no_others(
    bundle: Path,
    open_page: Callable[[Path], Visit],  # noqa: F811
) -> None:
    seen = open_page(bundle)
    page = seen.page
    page.locator("#drawing .diagram").focus()
    for i in range(1, 7):
        page.keyboard.press("n")
        state(page, f"State_{i}").wait_for()
        page.locator("#drawing .diagram").focus()
    page.keyboard.press("Control+a")
    page.keyboard.press("Control+c")
    page.keyboard.press("Control+v")
    state(page, "A_2").wait_for()
    expect(page.locator("#drawing .state")).to_have_count(18)
    assert page.evaluate(OVERLAPS) == 0
    assert seen.errors == []


def test_a_held_key_moves_a_state_by_each_of_its_steps(
    bundle: Path,
    open_page: Callable[[Path], Visit],  # noqa: F811
) -> None:
    seen = open_page(bundle)
    page = seen.page
    state(page, "B").click()
    page.locator("#drawing .diagram").focus()
    box = page.locator("#drawing [data-state=B] .box")
    x = float(box.get_attribute("x") or 0)
    for _ in range(100):
        page.keyboard.down("ArrowRight")  # repeats
    page.keyboard.up("ArrowRight")
    page.wait_for_function(
        "([x, box]) => Math.abs(Number(document.querySelector(box).getAttribute('x')) - x) < 0.1",
        arg=[x + 1000, "#drawing [data-state=B] .box"],
    )
    assert seen.errors == []


def test_a_hundred_steps_are_undone_and_made_again(
    bundle: Path,
    open_page: Callable[[Path | Document], Visit],  # noqa: F811
) -> None:
    before = files_of(bundle)
    document = Document(bundle)
    for i in range(100):
        document.apply([AddState(f"N{i}", 150.0 * (i % 10), 90.0 * (i // 10))])
    done = files_of(bundle)
    seen = open_page(document)
    page = seen.page
    page.locator("#drawing .diagram").focus()
    for press, button, files in (
        ("Control+z", "#undo", before),
        ("Control+Shift+z", "#redo", done),
    ):
        for _ in range(100):
            page.keyboard.press(press)
        expect(page.locator(button)).to_be_disabled()
        wait_for(lambda files=files: files_of(bundle) == files, "everything is written")
    expect(page.locator("#drawing .state")).to_have_count(103)
    assert seen.errors == []


def test_fields_of_messages_are_completed(
    lamp: Path,
    open_page: Callable[[Path], Visit],  # noqa: F811
) -> None:
    seen = open_page(lamp)
    page = seen.page
    state(page, "On").click()
    text = page.locator("[data-place='On|Internal'] .cm-content")
    offered = page.locator(".cm-tooltip-autocomplete li")
    text.click()
    page.keyboard.type("if level.")
    expect(offered).to_have_text(["on", "value"])
    page.keyboard.type("v")
    expect(offered).to_have_text(["value"])
    offered.click()
    expect(text).to_have_text("if level.value")
    page.keyboard.type(" > cou")
    expect(offered.first).to_have_text("count")
    offered.first.click()

    # Those of a message that is made, also behind another one in it.
    text.click()
    page.keyboard.press("Control+a")
    page.keyboard.press("Delete")
    page.keyboard.type("lamp(Level(value=min(1, count), o")
    expect(offered.first).to_have_text("on=")
    offered.first.click()
    expect(text).to_have_text("lamp(Level(value=min(1, count), on=))")
    assert seen.errors == []
