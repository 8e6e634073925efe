"""Machines are debugged on the page, and go on when it is closed."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from typing import Any

import pytest
from playwright.sync_api import expect

from llfsm.runtime.presence.remote import Directory
from llfsm.whiteboard import Whiteboard
from llfsm.whiteboard.messages.llfsm import MachineRequest, request_slot
from waiting import wait_for

from .conftest import Server

pytestmark = pytest.mark.timeout(240)

NAME = "RosBlindTurttleBot"

REACHED = """part => {
  part.scrollIntoView({ block: "center" });
  const { x, y, width, height } = part.getBoundingClientRect();
  return part.contains(document.elementFromPoint(x + width / 2, y + height / 2));
}"""


def test_break_see_why_step_and_continue(
    board: str, start: Callable[..., Any], visit: Callable[..., Any]
) -> None:
    start("turtlesim", "-b", board)
    start("run", NAME, "RosWallTurttleBot", "-q", "-b", board)
    server = start(Server, board, "--control")
    seen = visit(server.address)
    card = seen.page.locator(f"[data-machine={NAME}]")
    breakpoint = card.get_by_label(f"New breakpoint of {NAME}")
    breakpoint.fill("TURN_LEFT_")
    breakpoint.press("Enter")
    expect(card.locator(".debugging .refused")).to_contain_text("no state of RosBlindTurttleBot")
    breakpoint.fill("TURN_RIGHT")
    breakpoint.press("Enter")
    expect(card.locator(".breakpoints")).to_contain_text(f"{NAME}:TURN_RIGHT")
    expect(card.locator(".pill")).to_have_text("paused")
    expect(card.locator(".paused")).to_have_text(f"Paused: breakpoint {NAME}:TURN_RIGHT")
    expect(card.locator(".before caption")).to_have_text("seen as it left STRAIGHT")
    expect(card.locator(".before [data-is=true]")).to_have_count(1)
    expect(card.locator(".before")).to_contain_text(re.compile(r"[0-9.]+ ms > [0-9]+ ms"))
    ends = "clocks run on. The machines continue 6 s after the last such page is closed."
    expect(card.locator(".pausing")).to_contain_text(ends)

    # Another page sees the same, and steps.
    other = visit(server.address)
    there = other.page.locator(f"[data-machine={NAME}]")
    expect(there.locator(".pill")).to_have_text("paused")
    there.locator("[data-debug=round]").click()
    expect(card.locator(".paused")).to_have_text("Paused: step: round")
    caption = card.locator(".why:not(.before) caption")
    expect(caption).to_have_text("transitions of TURN_RIGHT, as they would be now")
    there.locator("[data-debug=round]").click()
    evaluated = re.compile("^transitions of TURN_RIGHT, as evaluated .*(now|ago)$")
    expect(caption).to_have_text(evaluated)

    card.locator(".breakpoints button").click()
    expect(card.locator(".breakpoints button")).to_have_count(0)
    card.locator("[data-debug=continue]").click()
    expect(there.locator(".pill")).to_have_text("running")
    there.locator("[data-debug=pause]").click()
    expect(card.locator(".pill")).to_have_text("paused")
    assert seen.errors == other.errors == []
    wall = seen.page.locator("[data-machine=RosWallTurttleBot]")
    override = wall.get_by_label("Override a sensor of RosWallTurttleBot")
    expect(wall.locator(".sensors caption")).to_have_text("Sensors")
    expect(wall.locator(".sensors")).to_contain_text(re.compile("answer(None|TurtlePosition)"))
    override.fill("answr null")
    override.press("Enter")
    expect(wall.locator(".debugging .refused")).to_contain_text("has no sensor 'answr'")
    override.fill("answer null")
    override.press("Enter")
    for page in (seen.page, other.page):
        mark = page.locator(".overrides button")
        expect(mark).to_contain_text("answer is overridden")
    mark.click()
    expect(wall.locator(".overrides button")).to_have_count(0)
    for page in (seen.page, other.page):
        page.close()
    with Whiteboard(board, create=False) as wb:
        machine = Directory(wb)
        wait_for(lambda: machine.find(NAME).condition == "running", "it goes on without the pages")


def test_without_control_why_is_shown_and_nothing_can_be_done(
    board: str, start: Callable[..., Any], visit: Callable[..., Any]
) -> None:
    start("run", "RosPingPong", "-q", "-b", board)
    seen = visit(start(Server, board).address)
    card = seen.page.locator("[data-machine=RosPingPong]")
    expect(card.locator(".why:not(.before) caption")).to_contain_text("transitions of")
    expect(card.locator(".debugging button, .debugging input")).to_have_count(0)
    assert seen.errors == []


def test_a_page_that_draws_nothing_renews_what_it_holds(
    board: str, start: Callable[..., Any], visit: Callable[..., Any]
) -> None:
    """As a window behind others, or a card that is folded or out of sight."""
    start("run", "RosPingPong", "-q", "-b", board)
    server = start(Server, board, "--control")
    seen = visit(server.address)
    seen.page.locator("[data-debug=pause]").click()
    expect(seen.page.locator(".card .pill")).to_have_text("paused")
    hidden = visit("about:blank")
    hidden.page.add_init_script("window.requestAnimationFrame = () => 0")
    hidden.page.goto(server.address)
    expect(hidden.page.locator("#link")).to_have_text("live")
    seen.page.close()
    with Whiteboard(board, create=False) as wb:
        slot = wb[request_slot("RosPingPong")]
        for _ in range(2):
            before = slot.count
            wait_for(lambda before=before: slot.count > before + 1, "it renews again")
            assert slot.get() == MachineRequest("renew", lease_s=6.0)
        assert Directory(wb).find("RosPingPong").condition == "paused"


def test_breakpoints_are_kept_in_the_browser(
    board: str, start: Callable[..., Any], visit: Callable[..., Any]
) -> None:
    """A robot that starts again has none: its page offers them, also one of a renamed state."""
    running = start("run", NAME, "-q", "-b", board)
    seen = visit(start(Server, board, "--control").address)
    card = seen.page.locator(f"[data-machine={NAME}]")
    breakpoint = card.get_by_label(f"New breakpoint of {NAME}")
    for text in ("TURN_LEFT", "TURN_RIGHT if False"):
        breakpoint.fill(text)
        breakpoint.press("Enter")
        if text != "TURN_LEFT":  # which is no state
            expect(card.locator(".breakpoints")).to_contain_text(text)
    place = f"{board} {NAME}"
    renamed = json.dumps({place: [f"{NAME}:LEFT", f"{NAME}:TURN_RIGHT if False"]})
    kept = "localStorage.getItem('llfsm.breakpoints')"
    assert json.loads(seen.page.evaluate(kept)) == {place: [f"{NAME}:TURN_RIGHT if False"]}
    running.end()
    seen.page.evaluate(f"localStorage.setItem('llfsm.breakpoints', {json.dumps(renamed)})")
    start("run", NAME, "-q", "-b", board)
    again = card.locator(".again button")
    left, right = f"{NAME}:LEFT \u21bb", f"{NAME}:TURN_RIGHT if False \u21bb"
    expect(again).to_have_text([left, "\u00d7", right, "\u00d7"])
    again.nth(0).click()
    expect(card.locator(".debugging .refused")).to_contain_text(f"no state of {NAME} 'LEFT'")
    again.nth(2).click()
    expect(card.locator(".breakpoints")).to_contain_text("TURN_RIGHT if False \u00d7")
    expect(again).to_have_text([left, "\u00d7"])
    again.nth(1).click()
    expect(again).to_have_count(0)
    card.locator(".breakpoints button").click()
    expect(card.locator(".breakpoints button")).to_have_count(0)
    assert json.loads(seen.page.evaluate(kept)) == {}
    assert seen.errors == []


def test_all_breakpoints_that_are_typed_are_kept(
    board: str, start: Callable[..., Any], visit: Callable[..., Any]
) -> None:
    """Also one after the other without a wait, and one that a command has set before."""
    start("run", NAME, "-q", "-b", board, "--break", f"{NAME}:END")
    seen = visit(start(Server, board, "--control").address)
    card = seen.page.locator(f"[data-machine={NAME}]")
    expect(card.locator(".breakpoints")).to_have_text(f"{NAME}:END \u00d7")
    typed = ["TURN_RIGHT if False", "END", "INITIAL if False"]
    breakpoint = card.get_by_label(f"New breakpoint of {NAME}")
    for text in typed:
        breakpoint.fill(text)
        breakpoint.press("Enter")
    expect(card.locator(".breakpoints button")).to_have_count(3)
    kept = "localStorage.getItem('llfsm.breakpoints')"
    whole = sorted(f"{NAME}:{text}" for text in typed)
    assert sorted(json.loads(seen.page.evaluate(kept))[f"{board} {NAME}"]) == whole
    assert seen.errors == []


def test_all_of_a_card_can_be_reached_however_much_is_shown(
    board: str, start: Callable[..., Any], visit: Callable[..., Any]
) -> None:
    start("run", "RosWallTurttleBot", "-q", "-b", board)
    seen = visit(start(Server, board, "--control").address)
    seen.page.set_viewport_size({"width": 1280, "height": 600})
    card = seen.page.locator(".card")
    card.locator("[data-debug=pause]").click()
    expect(card.locator(".pausing")).to_be_visible()
    card.get_by_text("Fit", exact=True).click()
    for part in ("[data-action=stop]", "[data-state=END]"):
        wait_for(lambda: card.locator(part).evaluate(REACHED), f"{part} is reached")  # noqa: B023
