"""The live machine is reloaded from the page, if that may, with what was edited there."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from threading import Thread

import pytest
from playwright.sync_api import expect

from llfsm.bridges.view.live_source import LiveSource
from llfsm.runtime import Arrangement
from llfsm.runtime.bundles import load_bundle
from llfsm.whiteboard import Board, Whiteboard
from llfsm.whiteboard.messages.llfsm import request_slot

from ..view.conftest import Visit, browser, visit  # noqa: F401
from .conftest import EditServer, FakeWindow

pytestmark = pytest.mark.timeout(240)


@pytest.fixture
def board() -> Board:
    return Whiteboard.local()


@pytest.fixture
def live(lamp: Path, board: Board) -> Iterator[Arrangement]:
    arrangement = Arrangement([load_bundle(lamp)], whiteboard=board)
    runner = Thread(target=arrangement.run, kwargs={"grace_s": 0.0})
    runner.start()
    yield arrangement
    arrangement.stop()
    runner.join()


@pytest.fixture
def serve(lamp: Path, board: Board) -> Iterator[Callable[[bool], EditServer]]:
    servers = []

    def serve(control: bool) -> EditServer:
        servers.append(EditServer(lamp, LiveSource("robot", given=board), control=control))
        return servers[-1]

    yield serve
    for server in servers:
        server.end()


def test_what_is_edited_runs_after_a_reload(
    live: Arrangement,
    serve: Callable[[bool], EditServer],
    visit: Callable[..., Visit],  # noqa: F811
) -> None:
    seen = visit(f"http://{serve(True).host}/?token=secret")
    page = seen.page
    expect(page.locator("#live")).to_have_text("robot: Off")
    page.locator("#drawing [data-state=Off]").click()
    page.keyboard.press("F2")
    page.keyboard.type("Dark")
    page.keyboard.press("Enter")
    expect(page.locator("#drawing [data-state=Dark]")).to_be_visible()
    page.keyboard.press("l")
    expect(page.locator("#toasts")).to_have_text("Reloaded: it is in Dark")
    expect(page.locator("#live")).to_have_text("robot: Dark")
    assert live.state_name_of("Lamp") == "Dark"

    page.locator("[data-place='Dark|OnEntry'] .cm-content").click()
    page.keyboard.press("Control+a")
    page.keyboard.insert_text("lamp(")
    page.locator("#reload").click()  # what was typed is written before
    expect(page.locator("#toasts")).to_contain_text("Not reloaded: ")
    expect(page.locator("#live")).to_have_text("robot: Dark, not reloaded")
    why = page.locator("#live").get_attribute("title") or ""
    assert "State_Dark_OnEntry.py:1: " in why
    assert live.state_name_of("Lamp") == "Dark"


def test_a_page_without_control_reloads_nothing(
    live: Arrangement, serve: Callable[[bool], EditServer], board: Board
) -> None:
    with serve(False).connect() as socket:
        window = FakeWindow(socket)
        window.wait(lambda shown: shown.get("live", {}).get("state") == "Off")
        assert "start it with --control" in window.ask("reload")["problem"]
    assert board[request_slot("Lamp")].count == 0
    with serve(True).connect() as socket:
        window = FakeWindow(socket)
        window.wait(lambda shown: shown.get("live", {}).get("state") == "Off")
        # Nothing of a request but the machine of the page is looked at.
        window.ask("reload", machine="Other", path="/etc", argument="/etc")
        assert board[request_slot("Lamp")].get().argument == ""
