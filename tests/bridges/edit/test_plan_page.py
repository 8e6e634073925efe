"""An arrangement file on pages: one for each machine, and an overview that joins them."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Thread

import pytest
from playwright.sync_api import expect
from websockets.exceptions import InvalidStatus

from llfsm.bridges.edit.edit_app import OpenedMachine, OpenedPlan, overview_data
from llfsm.bridges.view.live_source import LiveSource
from llfsm.runtime import Arrangement
from llfsm.runtime.bundles import load_bundle
from llfsm.runtime.converting.class_process import ClassName
from llfsm.runtime.editing import Document
from llfsm.runtime.editing.class_document import ClassDocument
from llfsm.runtime.plans import PlannedMachine
from llfsm.whiteboard import Whiteboard
from llfsm.whiteboard.board import Board

from ..view.conftest import Visit, browser, visit  # noqa: F401
from .conftest import EditServer, FakeWindow

pytestmark = pytest.mark.timeout(240)

PATROL = """\
from llfsm.runtime import Machine, State


class Patrol(Machine):
    GO = State()

    @GO.on_entry
    def _(self) -> None:
        self.suspend("Spot")
"""


@pytest.fixture
def board() -> Board:
    return Whiteboard.local()


@pytest.fixture
def server(
    bundle: Path, lamp: Path, board: Board, monkeypatch: pytest.MonkeyPatch
) -> Iterator[EditServer]:
    """Serve two bundles, a class and a machine that is not there."""
    folder = bundle.parent
    (folder / "patrol.py").write_text(PATROL)
    monkeypatch.setattr(sys, "path", [str(folder), *sys.path])
    patrol = ClassDocument(ClassName(folder / "patrol.py", "patrol", "Patrol"))
    slots = {"lamp": "spot/lamp"}
    machines = {
        "M": OpenedMachine(PlannedMachine(definition="M"), Document(bundle)),
        "Spot": OpenedMachine(PlannedMachine(definition="Lamp", slots=slots), Document(lamp)),
        "a/b": OpenedMachine(PlannedMachine(definition="patrol.py:Patrol"), patrol),
        "Gone": OpenedMachine(PlannedMachine(definition="Gone"), None, "no machine 'Gone'"),
    }
    source = LiveSource("robot", given=board)
    server = EditServer(OpenedPlan(folder / "robot.toml", machines), source)
    yield server
    server.end()


@contextmanager
def window(server: EditServer, name: str) -> Iterator[FakeWindow]:
    with server.connect(page=f"/machine/{name}/") as socket:
        opened = FakeWindow(socket)
        opened.wait(lambda shown: "shape" in shown and shown.get("live"))
        yield opened


def test_each_machine_has_a_page_of_its_own(server: EditServer, lamp: Path, board: Board) -> None:
    # The live machine is the one that has its name in the file.
    arrangement = Arrangement(whiteboard=board)
    arrangement.load(load_bundle(lamp), name="Spot")
    runner = Thread(target=arrangement.run)
    with window(server, "M") as one, window(server, "Spot") as other:
        assert (one.shown["name"], other.shown["name"]) == ("M", "Lamp")
        before = {path: path.read_bytes() for path in lamp.iterdir()}
        rename = {"edit": "rename state", "state": "B", "to": "Z"}
        assert one.apply(rename)["done"] == "wrote 4 files"
        assert "there is nothing to undo" in other.ask("undo")["problem"]
        assert {path: path.read_bytes() for path in lamp.iterdir()} == before
        try:
            runner.start()
            other.wait(lambda shown: shown["live"]["state"] == "Off")
            assert one.shown["live"]["state"] is None
        finally:
            arrangement.stop()
            runner.join()


def test_an_address_gives_no_access_to_anything_else(server: EditServer) -> None:
    about = server.get("/machine/a%2Fb/about?token=secret").json()
    assert about["title"] == "a/b"
    assert [tab["address"] for tab in about["tabs"]] == [
        "/", "/machine/M/", "/machine/Spot/", "/machine/a%2Fb/", "/machine/Gone/"
    ]  # fmt: skip
    assert server.get("/machine/Gone/about?token=secret").json()["problem"] == "no machine 'Gone'"
    for other in ("Lamp", "..%2FM", "M%2F..", ""):
        answer = server.get(f"/machine/{other}/about?token=secret").json()
        assert "problem" in answer, other
    for path in ("/about", "/overview", "/machine/M/about"):
        assert server.get(path).status_code == 401
        assert server.get(f"{path}?token=secret", host="evil.example").status_code == 403
    for page, query in (
        ("/machine/M/", ""),
        ("/machine/Gone/", "?token=secret"),
        ("/", "?token=secret"),
    ):
        with pytest.raises(InvalidStatus, match="403"), server.connect(query, page=page):
            pass


def test_a_machine_that_cannot_be_loaded_any_more_has_no_links(bundle: Path, lamp: Path) -> None:
    opened = {
        each.stem: OpenedMachine(PlannedMachine(definition=each.stem), Document(each))
        for each in (bundle, lamp)
    }
    (bundle / "State_A_Transition_0.target").write_text("Nowhere\n")
    shown = overview_data(OpenedPlan(bundle.parent / "robot.toml", opened))
    assert shown["problems"].keys() == {"M"}
    assert "'Nowhere' is not a state" in shown["problems"]["M"]
    boxes = shown["diagram"]["boxes"]
    assert [each["state"] for each in boxes if not each["slot"]] == ["M", "Lamp"]
    assert {each["source"] for each in shown["diagram"]["edges"]} == {"Lamp", "level"}


def test_the_overview_leads_to_the_machines(
    server: EditServer,
    visit: Callable[..., Visit],  # noqa: F811
    lamp: Path,
) -> None:
    (lamp / "State_Off_OnEntry.py").write_text("restart('M')\n")
    seen = visit(f"http://{server.host}/?token=secret")
    page = seen.page
    tabs = page.locator("#tabs a")
    expect(tabs).to_have_text(["Overview", "M", "Spot", "a/b", "Gone"])
    expect(page.locator("#inspector .problem")).to_have_text("no machine 'Gone'")
    page.get_by_role("button", name="Draw").click()
    expect(page.locator("#drawing .slot title")).to_have_text(["spot/lamp", "level"])
    arrows = page.locator("#drawing g.transition:not(.label)")
    drawn = {arrow.get_attribute("data-transition") for arrow in arrows.all()}
    assert drawn == {"Spot:0", "Spot:1", "level:0", "a/b:0"}
    page.locator("#drawing [data-state=Spot]").click()
    expect(page.locator("#tabs [aria-current]")).to_have_text("Spot")
    page.locator("#drawing [data-state=Off]").wait_for()
    tabs.get_by_text("Gone").click()
    expect(page.locator("#trouble")).to_have_text("No machine 'Gone'")
    for key in "n+0rai":  # nothing to draw on
        page.keyboard.press(key)
    tabs.get_by_text("M", exact=True).click()
    page.locator("#drawing [data-state=Lost]").wait_for()
    assert seen.errors == []
