"""Texts are written in the browser as somebody types: key by key, with what is completed."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Page, expect

from llfsm.bridges.view.live_source import LiveSource
from llfsm.runtime.bundles import load_bundle, read_bundle
from llfsm.whiteboard import Message, Slot, Whiteboard
from waiting import wait_for

from ..view.conftest import Visit, browser, visit  # noqa: F401
from .conftest import EditServer
from .test_edit_page import files_of, open_page, state, write  # noqa: F401

pytestmark = [
    pytest.mark.timeout(240),
    pytest.mark.filterwarnings("ignore::llfsm.runtime.UnreachableStateWarning"),
]

READY_MS = (
    150  # a list of completions takes no key before, lest it take what was meant for the text
)


class Wind(Message):
    speed: float = 0.0
    gusts: bool = False


@pytest.fixture
def page(
    bundle: Path,
    visit: Callable[..., Visit],  # noqa: F811
) -> Iterator[Page]:
    """Show the bundle beside a board with a slot of somebody's own type, and one of ROS."""
    (bundle / "State_A_Transition_0.expr").write_text("count > 9\n")
    board = Whiteboard.local()
    board.add_message(Slot("weather/wind", Wind), Wind())
    server = EditServer(bundle, LiveSource("robot", given=board))
    seen = visit(f"http://{server.host}/?token=secret")
    with seen.page.expect_response(re.compile("/offered")):
        seen.page.reload()
    expect(seen.page.locator("#inspector h3").first).to_be_visible()
    yield seen.page
    assert seen.errors == []
    server.end()


def editor(page: Page, place: str) -> None:
    """Put the cursor at the end of a text."""
    page.locator(f"[data-place='{place}'] .cm-content").click()
    page.keyboard.press("Control+End")


def clear(page: Page, place: str) -> None:
    editor(page, place)
    page.keyboard.press("Control+a")
    page.keyboard.press("Delete")


def take(page: Page, what: str) -> None:
    """Choose what the list of completions has at its top; it takes no key at first."""
    top = page.locator(".cm-tooltip-autocomplete li").first
    expect(top).to_have_text(what)
    top.click()
    expect(page.locator(".cm-tooltip-autocomplete")).to_have_count(0)


def test_types_of_ros_and_of_the_board_are_included(page: Page, bundle: Path) -> None:
    editor(page, "|Variables")
    page.keyboard.press("Enter")
    page.keyboard.type("scan = Sensor")
    take(page, "Sensor")
    page.keyboard.type("(Slot")
    take(page, "Slot")
    page.keyboard.type('("scan", LaserSc')
    take(page, "LaserScansensor_msgs/msg/LaserScan")
    page.keyboard.press("End")
    page.keyboard.press("Enter")

    # The name of a slot that is on the board brings its type.
    page.keyboard.type('wind = Sensor(Slot("w')
    take(page, "weather/windWind")
    expect(page.locator("[data-place='|Includes']")).to_contain_text("class Wind(Message):")

    def types() -> dict[str, Slot[Any]]:
        ports = load_bundle(bundle).table.sensors.values()
        return {port.slot.name: port.slot for port in ports}

    wait_for(lambda: "Wind))" in (bundle / "M_Variables.py").read_text(), "it is written")
    made = types()
    assert made["weather/wind"].schema == Slot("weather/wind", Wind).schema
    assert made["scan"].type.__type_name__ == "sensor_msgs/msg/LaserScan"

    # Another type of a name that is taken gets another one.
    page.keyboard.press("End")
    page.keyboard.press("Enter")
    for name, detail, called in (
        ("here", "turtlesim/msg/Pose", "Pose"),
        ("there", "geometry_msgs/msg/Pose", "GeometryMsgsPose"),
    ):
        page.keyboard.type(f'{name} = Sensor(Slot("{name}", Pose')
        page.locator(".cm-tooltip-autocomplete li", has_text=re.compile(f"{detail}$")).click()
        expect(page.locator("[data-place='|Variables']")).to_contain_text(f'"{name}", {called}))')
        page.keyboard.press("End")
        page.keyboard.press("Enter")
    for file in ("Variables", "Includes"):
        wait_for(lambda: "GeometryMsgsPose" in (bundle / f"M_{file}.py").read_text(), "written")  # noqa: B023
    names = {slot.type.__type_name__ for slot in types().values()}
    assert {"turtlesim/msg/Pose", "geometry_msgs/msg/Pose"} < names

    # Fields of a type of ROS are completed, too; a type and what includes it are undone together.
    state(page, "B").click()
    editor(page, "B|OnEntry")
    page.keyboard.type("scan.header.fr")
    take(page, "frame_id")
    expect(page.locator("[data-place='B|OnEntry'] .cm-content")).to_have_text(
        "scan.header.frame_id"
    )


def test_what_is_typed_is_what_is_written(page: Page, bundle: Path) -> None:
    state(page, "A").click()
    clear(page, "A|OnEntry")
    page.keyboard.type('"""Counts."""')
    page.keyboard.press("Enter")
    page.keyboard.type("if count:")
    page.keyboard.press("Enter")
    page.keyboard.type("pass")
    expect(page.locator(".cm-tooltip-autocomplete li").first).to_have_text("pass")
    page.keyboard.press("Enter")
    page.keyboard.type("count += 1")
    text = '"""Counts."""\nif count:\n    pass\n    count += 1\n'
    wait_for(lambda: (bundle / "State_A_OnEntry.py").read_text() == text, "it is written")

    # Enter ends a condition, in which Tab goes on and writes nothing.
    clear(page, "A|1")
    page.keyboard.type("count > 4")
    page.keyboard.press("Enter")
    expect(page.locator("#drawing .diagram")).to_be_focused()
    page.locator("[data-place='A|1'] .cm-content").click()
    page.keyboard.press("Tab")
    expect(page.locator("[data-row='A:1'] select")).to_be_focused()
    second = lambda: read_bundle(bundle).states[0].transitions[1].expression  # noqa: E731
    wait_for(lambda: getattr(second(), "text", "") == "count > 4\n", "the condition is written")


def test_what_is_wrong_is_reported_under_its_line(page: Page) -> None:
    state(page, "A").click()
    write(page, "A|1", "cuont > 3")
    found = page.locator("[data-place='A|1'] .cm-line + .found")
    printed = "nothing is called 'cuont'; did you mean 'count'?"
    expect(found).to_have_attribute("data-text", printed)
    expect(page.get_by_role("note", name=printed)).to_be_visible()
    write(page, "A|OnEntry", "count = 1\nnothing()\ncount = 2")
    lines = page.locator("[data-place='A|OnEntry'] .cm-content > *")
    expect(lines).to_have_count(4)
    expect(lines.nth(2)).to_have_attribute("data-text", "nothing is called 'nothing'")
    page.locator("[data-place='A|OnEntry'] .cm-line").first.click()
    page.keyboard.press("Home")
    page.keyboard.type("pass\n")
    expect(lines).to_have_text(["pass", "count = 1", "nothing()", "", "count = 2"])
    expect(lines.nth(3)).to_have_attribute("data-text", "nothing is called 'nothing'")


def test_what_another_program_has_written_meanwhile_is_shown(page: Page, bundle: Path) -> None:
    file = bundle / "State_A_OnEntry.py"
    state(page, "A").click()
    editor(page, "A|OnEntry")
    page.evaluate("() => { window.held = setTimeout; window.setTimeout = () => 0; }")
    page.keyboard.insert_text("  # mine")  # is not sent yet
    file.write_text("count += 5\n")
    page.evaluate("() => { window.setTimeout = window.held; }")
    page.keyboard.insert_text("!")
    note = page.locator("[data-place='A|OnEntry'] .problem")
    expect(note).to_contain_text("State_A_OnEntry.py has changed meanwhile")
    expect(note.locator("pre")).to_have_text("count += 5\n")
    assert file.read_text() == "count += 5\n"
    note.get_by_text("Keep mine").click()
    wait_for(lambda: file.read_text() == "count += 1  # mine!\n", "it is kept")
    expect(note).to_be_hidden()


def test_what_is_typed_without_a_server_is_written_when_there_is_one(
    bundle: Path,
    visit: Callable[..., Visit],  # noqa: F811
) -> None:
    server = EditServer(bundle)
    page = visit(f"http://{server.host}/?token=secret").page
    state(page, "A").click()
    editor(page, "A|OnEntry")
    server.end()
    expect(page.locator("#link")).to_have_text("reconnecting")
    page.keyboard.insert_text("  # mine")
    note = page.locator("[data-place='A|OnEntry'] .problem")
    expect(note).to_contain_text("not connected")
    state(page, "B").click()
    state(page, "A").click()
    text = page.locator("[data-place='A|OnEntry'] .cm-content")
    expect(text).to_have_text("count += 1  # mine")
    expect(note).to_be_visible()
    state(page, "B").click()

    file = bundle / "State_A_OnEntry.py"
    again = EditServer(bundle, port=int(server.host.rpartition(":")[2]))
    wait_for(lambda: file.read_text() == "count += 1  # mine\n", "it is written")
    state(page, "A").click()
    expect(text).to_have_text("count += 1  # mine")
    expect(note).to_be_hidden()
    again.end()


def test_completions_that_come_late_do_not_stay(page: Page) -> None:
    state(page, "A").click()
    clear(page, "A|OnExit")
    clear(page, "A|OnEntry")
    page.keyboard.type("cou")
    page.keyboard.press("Control+Enter")  # to the next text
    page.keyboard.type("pas")
    lists = page.locator(".cm-tooltip-autocomplete")
    expect(page.locator("[data-place='A|OnExit'] .cm-tooltip-autocomplete")).to_be_visible()
    expect(lists).to_have_count(1)
    page.keyboard.press("Escape")
    expect(lists).to_have_count(0)
    page.keyboard.press("Escape")
    expect(page.locator("[data-place='A|OnExit'] .cm-content")).not_to_be_focused()


def test_what_cannot_be_written_is_kept_until_it_can(page: Page, bundle: Path) -> None:
    state(page, "A").click()
    editor(page, "A|OnEntry")
    away = bundle.with_name("away")
    bundle.rename(away)
    page.keyboard.insert_text("  # mine")
    note = page.locator("[data-place='A|OnEntry'] .problem")
    expect(note).to_contain_text("No such file or directory")
    expect(page.locator("#link")).to_have_text("not saved")
    note.get_by_text("Try again").click()
    expect(note).to_contain_text("No such file or directory")
    expect(page.locator("#trouble")).to_be_visible()
    away.rename(bundle)
    expect(note).to_be_hidden()
    expect(page.locator("#link")).to_have_text("saved")
    file = bundle / "State_A_OnEntry.py"
    wait_for(lambda: file.read_text() == "count += 1  # mine\n", "it is written")


def test_it_is_written_in_the_language_of_the_bundle(
    bundle: Path,
    open_page: Callable[[Path], Visit],  # noqa: F811
) -> None:
    (bundle / "Language").write_text("c++\n")
    for name in ("A", "B", "Lost"):
        (bundle / f"State_{name}.h").write_text("int numberOfTransitions() { return 0; }\n")
        (bundle / f"State_{name}_OnEntry.mm").write_text("if (not done) return; // not Python\n")
    (bundle / "M.mm").write_text("// M\n")
    before = files_of(bundle)
    seen = open_page(bundle)
    state(seen.page, "A").click()
    text = seen.page.locator("[data-place='A|OnEntry'] .cm-line")
    expect(text).to_have_text("if (not done) return; // not Python")
    expect(text.locator("span")).to_have_count(0)
    assert files_of(bundle) == before
    assert seen.errors == []
