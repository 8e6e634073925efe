"""The page of a fleet in a real browser: trouble first, and a click to a host's own page."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import expect

from llfsm.whiteboard import Whiteboard
from llfsm.whiteboard.messages.llfsm import HOSTS, Hosts
from mirrored_hosts import hosts_in, number_slot
from waiting import wait_for

from .conftest import Server
from .fleets import ERROR, MACHINES, FleetServer, fill, start_daemons

pytestmark = pytest.mark.timeout(240)

NAMES = "[...document.querySelectorAll('.host')].map(row => row.dataset.host)"


def test_of_a_hundred_hosts_those_in_trouble_come_first(
    board: str, start: Callable[..., Any], visit: Callable[..., Any]
) -> None:
    with Whiteboard(board) as wb:
        fill(wb, 100)
        seen = visit(start(Server, board, "--fleet").address)
        page = seen.page
        expect(page.locator(".host")).to_have_count(101)
        row = page.locator("[data-host=robot12]")
        expect(row.locator(".troubles")).to_have_text(f"Wall failed: {ERROR}")
        expect(row.locator(".machines")).to_have_text("1 of 4 in trouble")

        def first() -> list[str]:
            fill(wb, 100, silent="robot40")
            return list(page.evaluate(NAMES)[:5])

        wait_for(lambda: first() == ["robot40", "robot12", "robot3", "operator", "robot1"])
        expect(page.locator("[data-host=robot40] .state")).to_have_text("silent")
        expect(page.locator("[data-host=robot3] .clock")).to_contain_text("+")
        expect(page.locator("[data-host=robot4] .clock")).to_have_text(
            re.compile(r"^(0 ms|\D[1-9].*)$")
        )
        for width in (1440, 400):
            page.set_viewport_size({"width": width, "height": 900})
            assert page.evaluate("document.documentElement.scrollWidth") <= width, "it fits"

        page.keyboard.press("/")
        page.keyboard.type("ROBOT1")
        expect(page.locator(".host")).to_have_count(12)
        expect(page.locator("#fleet-number")).to_have_text("12 of 101")
        page.locator("#fleet-filter").fill("nothing like it")
        expect(page.locator("#fleet-empty")).to_have_text("No host has such a name.")
        page.locator("#fleet-filter").fill("")
        page.keyboard.press("Escape")
        page.keyboard.press("?")
        expect(page.locator("#keys")).to_be_visible()
        assert seen.errors == []


def test_a_click_leads_to_the_hosts_own_page_and_back(
    tmp_path: Path, start: Callable[..., Any], visit: Callable[..., Any]
) -> None:
    pose, theirs = number_slot("arm/angle"), number_slot("robot7/arm/angle")
    with hosts_in(tmp_path) as make_host:
        hosts = start_daemons(make_host, "robot7")
        hosts["robot7"].add(1, pose)
        start("run", f"{MACHINES}:Counts", "-q", *hosts["robot7"].select)
        operator = hosts["operator"].board
        seen = visit(start(FleetServer, hosts["operator"]).address)
        page = seen.page
        row = page.locator("[data-host=robot7]")
        expect(row.locator(".state")).to_have_text("ok")
        expect(page.locator("[data-host=operator]")).to_contain_text("this host")
        assert theirs.name not in operator.read_slots()

        row.click()
        expect(page.locator("#title")).to_have_text("robot7")
        expect(page.locator(f"[data-slot='{theirs.name}']")).to_be_visible()
        expect(page.locator("[data-machine='robot7/Counts'] [data-state=A]")).to_be_visible()
        page.keyboard.press("e")
        expect(page.locator("#log-table")).to_contain_text("robot7/Counts")
        assert "token" not in page.url
        assert theirs.name in operator.read_slots()

        page.locator("#back").click()
        expect(row.locator(".state")).to_have_text("ok")
        wait_for(lambda: theirs.name not in operator.read_slots(), "the end of the interest")
        with page.context.expect_page() as opened:
            row.click(modifiers=["Control"])
        beside = opened.value
        expect(beside.locator(f"[data-slot='{theirs.name}']")).to_be_visible()
        beside.close()
        page.goto("about:blank")
        wait_for(lambda: not {HOSTS.name, theirs.name} & operator.read_slots(), "no interest")
        assert seen.errors == []


def test_the_page_comes_back_with_the_hosts_that_are_there_then(
    board: str, start: Callable[..., Any], visit: Callable[..., Any]
) -> None:
    with Whiteboard(board) as wb:
        fill(wb, 12)
        server = start(Server, board, "--fleet")
        seen = visit(server.address)
        expect(seen.page.locator(".host")).to_have_count(13)
        wb.remove()
        expect(seen.page.locator("#trouble")).to_contain_text("was removed; waiting for a new one")
        expect(seen.page.locator(".host")).to_have_count(13)  # as they were
    with Whiteboard(board) as wb:
        fill(wb, 6)
        expect(seen.page.locator(".host")).to_have_count(7)
        server.end()
        expect(seen.page.locator("#link")).to_have_text("reconnecting")
        wb.add_message(HOSTS, Hosts(("operator", "robot13")))
        token = server.query.partition("=")[2]
        start(Server, board, "--fleet", port=server.port, LLFSM_VIEW_TOKEN=token)
        expect(seen.page.locator("[data-host=robot13]")).to_be_visible()
        expect(seen.page.locator(".host")).to_have_count(8)
        expect(seen.page.locator("[data-host=robot6] .state")).to_have_text("lost")
