"""What a state runs is edited in the page: a machine is dragged into it, or named there."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from playwright.sync_api import expect

from llfsm.runtime.bundles import Bundle, BundleState, read_bundle, write_bundle
from llfsm.runtime.engine.table import MachineLayout, StateBox
from waiting import wait_for

from ..view.conftest import Visit, browser, visit  # noqa: F401
from .test_edit_page import middle, open_page, state  # noqa: F401

pytestmark = pytest.mark.timeout(240)


@pytest.fixture
def mission(tmp_path: Path) -> Path:
    """Write a bundle that has two others beside it."""
    places = {"Work": StateBox(0, 0, 160, 80), "Rest": StateBox(0, 200, 160, 80)}
    states = (BundleState("Work"), BundleState("Rest"))
    for name in ("Arm", "Base"):
        write_bundle(Bundle(name, (BundleState("Only"),)), tmp_path / f"{name}.machine")
    folder = tmp_path / "Mission.machine"
    write_bundle(Bundle("Mission", states, layout=MachineLayout(places)), folder)
    return folder


def runs(folder: Path) -> dict[str, tuple[tuple[str, ...], bool]]:
    return {each.name: (each.runs, each.history) for each in read_bundle(folder).states}


def test_a_machine_is_dragged_into_a_state_and_named_there(
    mission: Path,
    open_page: Callable[[Path], Visit],  # noqa: F811
) -> None:
    page = open_page(mission).page
    machines = page.locator(".palette li")
    expect(machines).to_have_text(["Arm", "Base"])
    x, y = middle(state(page, "Work"))
    page.mouse.move(*middle(machines.nth(1)))
    page.mouse.down()
    page.mouse.move(x, y, steps=4)
    page.mouse.up()
    wait_for(lambda: runs(mission)["Work"] == (("Base",), False), "it runs Base")
    expect(page.locator("#runs")).to_have_value("Base")  # the state is selected
    expect(state(page, "Work")).to_contain_text("Base")

    page.locator("#runs").fill("Arm, Base")
    page.keyboard.press("Enter")
    wait_for(lambda: runs(mission)["Work"] == (("Arm", "Base"), False), "it runs both")
    page.get_by_role("button", name="History").click()
    wait_for(lambda: runs(mission)["Work"] == (("Arm", "Base"), True), "they go on later")
    expect(page.get_by_role("button", name="History")).to_have_attribute("aria-pressed", "true")

    page.locator("#runs").fill("Arm(to=max(1, 2), by=3) Base")
    page.keyboard.press("Enter")
    given = ("Arm(to=max(1, 2), by=3)", "Base")
    wait_for(lambda: runs(mission)["Work"] == (given, True), "it gives values")
    expect(page.locator("#runs")).to_have_value("Arm(to=max(1, 2), by=3), Base")
    page.locator("#runs").fill("no name")
    page.keyboard.press("Enter")
    wait_for(lambda: runs(mission)["Work"] == (("no", "name"), True), "names are not looked up")
    page.locator("#runs").fill("../Arm")
    page.keyboard.press("Enter")
    expect(page.locator("#toasts")).to_contain_text("'../Arm' is not the name of a machine")
    expect(page.locator("#runs")).to_have_value("no, name")
    page.locator("#runs").fill("")
    page.keyboard.press("Enter")
    wait_for(lambda: runs(mission)["Work"] == ((), False), "it runs nothing")
    expect(page.get_by_role("button", name="History")).to_have_count(0)


def test_a_machine_that_is_dropped_beside_states_runs_nowhere(
    mission: Path,
    open_page: Callable[[Path], Visit],  # noqa: F811
) -> None:
    page = open_page(mission).page
    x, y = middle(state(page, "Work"))
    page.mouse.move(*middle(page.locator(".palette li").first))
    page.mouse.down()
    page.mouse.move(x + 200, y, steps=4)
    page.mouse.up()
    state(page, "Rest").click()
    expect(page.locator("#runs")).to_have_value("")
    assert runs(mission) == {"Work": ((), False), "Rest": ((), False)}


def test_what_states_run_is_drawn_inside_of_them_and_folded_again(
    mission: Path,
    open_page: Callable[[Path], Visit],  # noqa: F811
) -> None:
    page = open_page(mission).page
    button = page.get_by_role("button", name="Unfold")
    expect(button).to_be_hidden()  # no state runs anything
    state(page, "Work").click()
    page.locator("#runs").fill("Arm, Gone")
    page.keyboard.press("Enter")
    button.click()
    inside = page.locator(".unfolded [data-state=Work] [data-state=Only]")
    expect(inside).to_have_count(1)
    expect(page.locator(".unfolded [data-state=Work]")).to_contain_text("Gone")
    page.locator("#runs").fill("Arm, Base")
    page.keyboard.press("Enter")
    expect(inside).to_have_count(2)  # as the bundle is now
    page.keyboard.press("Escape")
    page.keyboard.press("u")
    expect(page.locator(".unfolded")).to_have_count(0)
    state(page, "Work").click()
    button.click()
    page.locator("#runs").fill("")
    page.keyboard.press("Enter")
    expect(page.locator(".unfolded")).to_have_count(0)  # nothing is left to unfold
    expect(button).to_be_hidden()
