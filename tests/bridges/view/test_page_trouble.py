"""Trouble of machines on the page in a real browser: a failure, a hung section, two commanders."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import expect

import commanding
from llfsm.whiteboard import Whiteboard
from llfsm.whiteboard.messages.llfsm import status_slot
from waiting import wait_for

from .conftest import Server

pytestmark = pytest.mark.timeout(240)

FRAGILE = """
import time
from pathlib import Path
from llfsm.runtime import Machine, State

class Fragile(Machine):
    count: int = 0
    PLAN = State()
    DRIVE = State()
    PLAN.to(DRIVE, after_ms=50)

    @DRIVE.internal
    def _(self):
        if Path("broken").exists():
            raise ValueError("no plan <b>at all</b>")
        while Path("stuck").exists():
            time.sleep(0.01)

    DRIVE.to(DRIVE, when=lambda m: False)

class Other(Machine):
    A = State()
    A.to(A, after_ms=1000)
"""


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_a_machine_that_fails_or_hangs_shows_where_and_may_be_resumed(
    board: str,
    start: Callable[..., Any],
    visit: Callable[..., Any],
    tmp_path: Path,
    theme: str,
) -> None:
    (tmp_path / "fragile.py").write_text(FRAGILE)
    (tmp_path / "broken").touch()
    options = ("--on-error", "suspend", "--watchdog", "100", "-q", "-b", board)
    start("run", "fragile:Fragile", "fragile:Other", *options)
    server = start(Server, board, "--control")
    seen = visit(server.address, color_scheme=theme)
    page = seen.page
    card = page.locator("[data-machine=Fragile]")
    error, pill = card.locator(".error"), card.locator(".pill")
    plain = "getComputedStyle(document.querySelector('.error')).color"

    def marked() -> Any:
        """Return the colours of the error, the condition and the state that has failed or hangs."""
        return page.evaluate(
            """() => {
                const card = document.querySelector("[data-machine=Fragile]");
                const of = (what) => getComputedStyle(card.querySelector(what));
                const stroke = of("[data-state=DRIVE] .box").stroke;
                return [of(".error").color, of(".pill").color, stroke];
            }"""
        )

    expect(pill).to_have_text("failed")
    place = "machine Fragile, state DRIVE, Internal: ValueError: no plan <b>at all</b>"
    expect(error).to_contain_text(place)
    expect(error).to_contain_text("fragile.py:15")
    expect(card.locator(".failed")).to_have_attribute("data-state", "DRIVE")
    expect(card.locator(".held")).to_have_count(0)
    wait_for(lambda: len(set(marked())) == 1, "all are of one colour")
    problem = page.evaluate(plain)

    # Both ways to go on are offered; one that fails again stays failed.
    expect(card.locator("[data-action=suspend]")).to_be_disabled()
    card.locator("[data-action=restart]").click()
    expect(page.locator("#toasts")).to_contain_text(
        "asked to restart; it had failed: machine Fragile"
    )
    with Whiteboard(board, create=False) as wb:
        slot = wb[status_slot("Fragile")]

        def failed_again() -> bool:
            status = slot.get()
            return status.obeyed > 0 and not status.pending and status.failed

        wait_for(failed_again, "it has failed again")
    expect(pill).to_have_text("failed")
    (tmp_path / "broken").unlink()
    card.locator("[data-action=resume]").click()
    expect(pill).to_have_text("running")
    expect(error).to_be_hidden()
    expect(card.locator(".failed")).to_have_count(0)
    expect(card.locator(".current")).to_have_attribute("data-state", "DRIVE")

    (tmp_path / "stuck").touch()
    expect(pill).to_have_text("hung")
    expect(error).to_contain_text("fragile.py:17")
    expect(card.locator(".current")).to_have_attribute("data-state", "DRIVE")
    wait_for(lambda: set(marked()) == {problem}, "all are of the colour of problems")
    (tmp_path / "stuck").unlink()
    expect(pill).to_have_text("running")
    expect(error).to_be_hidden()
    assert seen.errors == []


def test_two_processes_that_command_a_slot_are_shown_until_one_ends(
    board: str, start: Callable[..., Any], visit: Callable[..., Any]
) -> None:
    first = start("run", f"{commanding.__file__}:Wall", "-q", "-b", board)
    with Whiteboard(board) as wb:
        wait_for(lambda: wb[status_slot("Wall")].count, "the first runs")
    seen = visit(start(Server, board).address)
    contested = seen.page.locator("#contested")
    seen.page.wait_for_selector("[data-machine=Wall]")
    expect(contested).to_be_hidden()
    second = start("run", f"{commanding.__file__}:Blind", "-q", "-b", board)
    expect(contested).to_have_text(
        f"cmd has two commanders: Wall (pid {first.popen.pid}), Blind (pid {second.popen.pid})"
    )
    expect(seen.page.locator("#trouble")).to_be_hidden()
    second.end()
    expect(contested).to_be_hidden()
    assert seen.errors == []
