"""Machines are debugged on the page, and go on when it is closed."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import pytest
from playwright.sync_api import expect

from llfsm.runtime.presence.remote import Directory
from llfsm.whiteboard import Whiteboard
from waiting import wait_for

from .conftest import Server

pytestmark = pytest.mark.timeout(240)

NAME = "RosBlindTurttleBot"


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

    # Another page sees the same, and steps.
    other = visit(server.address)
    there = other.page.locator(f"[data-machine={NAME}]")
    expect(there.locator(".pill")).to_have_text("paused")
    there.locator("[data-debug=round]").click()
    expect(card.locator(".paused")).to_have_text("Paused: step: round")
    expect(card.locator(".why:not(.before) caption")).to_have_text("transitions of TURN_RIGHT")

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
