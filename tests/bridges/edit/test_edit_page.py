"""The editor in a real browser: a machine is drawn and written by mouse and keyboard."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import pytest
from playwright.sync_api import Locator, Page, expect

from llfsm.runtime.bundles import (
    Bundle,
    BundleState,
    BundleTransition,
    Fragment,
    read_bundle,
    write_bundle,
)
from llfsm.runtime.editing import Document
from llfsm.runtime.engine.table import MachineLayout, StateBox
from waiting import wait_for

from ..view.conftest import Visit, browser, visit  # noqa: F401
from .conftest import EditServer

pytestmark = pytest.mark.timeout(240)


@pytest.fixture
def open_page(visit: Callable[..., Visit]) -> Iterator[Callable[[Path | Document], Visit]]:  # noqa: F811
    """Give a function that opens a bundle in the browser."""
    servers = []

    def open_page(folder: Path | Document) -> Visit:
        servers.append(EditServer(folder))
        seen = visit(f"http://{servers[-1].host}/?token=secret")
        expect(seen.page.locator("#inspector h3").first).to_be_visible()
        return seen

    yield open_page
    for server in servers:
        server.end()


def state(page: Page, name: str) -> Locator:
    return page.locator(f"#drawing [data-state={name}]")


def middle(where: Locator) -> tuple[float, float]:
    box = where.bounding_box()
    assert box is not None
    return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2


PASTE = """text => {
  const clipboardData = new DataTransfer();
  clipboardData.setData("text/plain", text);
  document.dispatchEvent(new ClipboardEvent("paste", { clipboardData, bubbles: true }));
}"""


def drag(page: Page, start: tuple[float, float], end: tuple[float, float]) -> None:
    page.mouse.move(*start)
    page.mouse.down()
    page.mouse.move(*[(a + b) / 2 for a, b in zip(start, end, strict=True)])
    page.mouse.move(*end)
    page.mouse.up()


def write(page: Page, place: str, text: str) -> None:
    page.locator(f"[data-place='{place}'] .cm-content").click()
    page.keyboard.press("Control+a")
    page.keyboard.insert_text(text)


def files_of(folder: Path) -> dict[str, bytes]:
    """Return what is in the files; nothing if one goes meanwhile."""
    with suppress(FileNotFoundError):
        return {path.name: path.read_bytes() for path in folder.iterdir()}
    return {}


def test_what_is_drawn_is_moved_led_elsewhere_reordered_and_undone(
    bundle: Path, open_page: Callable[[Path], Visit]
) -> None:
    before = files_of(bundle)
    seen = open_page(bundle)
    page = seen.page

    # Findings are on the diagram, and lead to their line.
    expect(state(page, "Lost")).to_have_class(re.compile("unreachable"))
    expect(page.locator("[data-transition='A:1'].label")).to_have_class(re.compile("dead"))
    page.locator("#findings .finding", has_text="can never fire").click()
    expect(page.locator("[data-place='A|1'] .cm-content")).to_be_focused()

    # Order by key: the second transition is evaluated first, and is not dead any more.
    page.keyboard.press("Alt+ArrowUp")
    expect(page.locator(".dead")).to_have_count(0)
    wait_for(
        lambda: read_bundle(bundle).states[0].transitions[1].expression is None,
        "the order is written",
    )

    # The arrow is led elsewhere, by its end.
    page.keyboard.press("Escape")
    page.locator("[data-transition='A:1'].label").click()
    drag(page, middle(page.locator("[data-handle=target]")), middle(state(page, "Lost")))
    expect(page.locator(".unreachable")).to_have_count(1)
    expect(state(page, "B")).to_have_class(re.compile("unreachable"))
    wait_for(
        lambda: read_bundle(bundle).states[0].transitions[1].target == "Lost",
        "the target is written",
    )

    # A box is dragged, and stays at the grid.
    x, y = middle(state(page, "B"))
    drag(page, (x, y), (x + 83, y + 41))
    wait_for(lambda: (bundle / "Layout.plist").exists(), "the layout is written")
    layout = read_bundle(bundle).layout
    assert layout is not None
    assert (layout.states["B"].x % 10, layout.states["B"].y % 10) == (0, 0)

    # Everything is undone, byte for byte, and nothing is left to undo.
    page.keyboard.press("Escape")
    for _ in range(3):
        page.keyboard.press("Control+z")
    expect(page.locator("#undo")).to_be_disabled()
    wait_for(lambda: files_of(bundle) == before, "everything is written as it was")
    assert seen.errors == []


def test_two_windows_and_another_program(
    bundle: Path,
    open_page: Callable[[Path], Visit],
    visit: Callable[..., Visit],  # noqa: F811
) -> None:
    one = open_page(bundle)
    other = visit(one.page.url + "?token=secret")
    state(other.page, "A").click()
    state(one.page, "A").click()
    write(one.page, "A|OnEntry", "count += 2")
    expect(other.page.locator("[data-place='A|OnEntry'] .cm-content")).to_have_text("count += 2")

    # Another program writes, once that text, which is shown before, is in its file.
    file = bundle / "State_A_OnEntry.py"
    wait_for(lambda: file.read_text() == "count += 2\n", "it is written")
    file.write_text("count += 5\n")
    expect(other.page.locator("[data-place='A|OnEntry'] .cm-content")).to_have_text("count += 5")
    expect(one.page.locator("[data-place='A|OnEntry'] .cm-content")).to_have_text("count += 5")
    one.page.keyboard.press("Escape")
    one.page.keyboard.press("Escape")

    # Copied in one window, and pasted in the other.
    state(other.page, "A").click()
    other.page.keyboard.press("F2")
    other.page.keyboard.type("First")
    other.page.keyboard.press("Enter")
    expect(state(one.page, "First")).to_be_visible()
    expect(state(one.page, "A")).to_have_count(0)
    assert one.errors == other.errors == []


def big(folder: Path, count: int) -> None:
    """Write a machine of so many states in a grid, each with two transitions."""
    names = [f"S{i}" for i in range(count)]
    states = tuple(
        BundleState(
            name,
            {"OnEntry": Fragment(f"count = {i}\n")},
            tuple(
                BundleTransition(names[(i + step) % count], Fragment(f"after_ms({i})\n"))
                for step in (1, 7)
            ),
        )
        for i, name in enumerate(names)
    )
    places = {
        name: StateBox(180.0 * (i % 6), 130.0 * (i // 6), 120, 60) for i, name in enumerate(names)
    }
    variables = Fragment("count: int = 0\n")
    write_bundle(Bundle("Big", states, variables=variables, layout=MachineLayout(places)), folder)


def test_a_state_of_thirty_is_renamed_and_moved_and_all_is_undone(
    tmp_path: Path, open_page: Callable[[Path], Visit]
) -> None:
    folder = tmp_path / "Big.machine"
    big(folder, 30)
    before = files_of(folder)
    seen = open_page(folder)
    page = seen.page
    state(page, "S7").click()
    page.keyboard.press("F2")
    page.keyboard.type("S8")
    page.keyboard.press("Enter")
    expect(page.locator("#name")).to_have_value("S7")
    page.keyboard.press("F2")
    page.keyboard.type("Seventh")
    page.keyboard.press("Enter")
    state(page, "Seventh").wait_for()
    former = folder / "State_S7_OnEntry.py"
    wait_for(lambda: not former.exists(), "the last of the files is written")
    made = read_bundle(folder)
    assert [t.target for t in made.states[6].transitions] == ["Seventh", "S13"]
    expect(page.locator("#name")).to_have_value("Seventh")
    page.locator("#drawing .diagram").focus()
    for _ in range(10):
        page.keyboard.press("ArrowRight")
        page.keyboard.press("ArrowDown")
    page.wait_for_function("() => !document.querySelector('#undo').disabled")

    def is_undone() -> bool:
        page.keyboard.press("Control+z")
        return page.locator("#undo").is_disabled()

    wait_for(is_undone, "everything is undone")
    wait_for(lambda: files_of(folder) == before, "everything is written as it was")
    assert seen.errors == []


def test_arrows_are_ordered_and_bent_and_states_pasted_into_another_machine(
    lamp: Path, bundle: Path, open_page: Callable[[Path], Visit]
) -> None:
    seen = open_page(lamp)
    page = seen.page

    # The second transition is dragged above the first.
    state(page, "On").click()
    rows = page.locator(".transitions li")
    handle = rows.nth(1).locator(".arrow")
    handle.drag_to(rows.nth(0).locator(".arrow"))
    first = lambda: read_bundle(lamp).states[1].transitions[0]  # noqa: E731
    wait_for(lambda: first().target == "Off", "the transitions are in another order")

    # An arrow is bent by its first circle.
    page.keyboard.press("Escape")
    page.locator("[data-transition='On:1'].label").click()
    x, y = middle(page.locator("[data-handle='bend:1']"))
    drag(page, (x, y), (x + 80, y))

    def is_bent() -> bool:
        layout = read_bundle(lamp).layout
        paths = layout.transitions.get("On", ()) if layout else ()
        return len(paths) == 2 and paths[1].control1[0] > paths[1].src[0] + 40

    wait_for(is_bent, "the arrow is bent")

    # Two states with their texts and what is between them go into another machine.
    state(page, "On").click()
    state(page, "End").click(modifiers=["Control"])
    page.keyboard.press("Control+c")
    other = open_page(bundle)
    other.page.locator("#drawing .diagram").focus()
    other.page.keyboard.press("Control+v")
    state(other.page, "End").wait_for()
    wait_for(lambda: len(read_bundle(bundle).states) == 5, "what was pasted is written")
    on, end = read_bundle(bundle).states[3:]
    assert (on.name, end.name) == ("On", "End")
    assert on.sections["OnEntry"].text == "print('on')\nlamp(Level(on=True))\n"
    [only] = on.transitions
    assert (only.target, only.expression) == ("End", Fragment("count >= 2\n"))
    expect(other.page.locator("#drawing .state.selected")).to_have_count(2)

    # What is not of this kind is no error, and changes nothing.
    for text in ("{", "null", '{"llfsm": "states"}', '{"llfsm": "states", "states": [{}]}'):
        other.page.evaluate(PASTE, text)
    assert [each.name for each in read_bundle(bundle).states[3:]] == ["On", "End"]
    assert seen.errors == other.errors == []


def test_a_machine_is_simulated_in_its_drawing(
    lamp: Path, open_page: Callable[[Path], Visit]
) -> None:
    seen = open_page(lamp)
    page = seen.page

    def press(name: str) -> None:
        page.get_by_role("button", name=name, exact=True).click()

    expect(page.locator("#simulation")).to_be_hidden()
    press("Simulate")
    press("Step")
    expect(page.locator("#simulated")).to_have_text("0.010 s, in Off")

    # A slider and a switch are its sensor; the state and the arrow that was taken are lit.
    page.get_by_label("Slider").fill("3")
    page.get_by_role("switch").check()
    press("Next state")
    expect(state(page, "On")).to_have_class(re.compile("current"))
    expect(page.locator("[data-transition='Off:0'].label")).to_have_class(re.compile("taken"))
    expect(page.locator(".values")).to_contain_text("count1")

    # It runs until a second later the message is too old; by then the drawing is another one.
    state(page, "On").click()
    page.keyboard.press("F2")
    page.keyboard.type("Bright")
    page.keyboard.press("Enter")
    state(page, "Bright").wait_for()
    page.keyboard.press("Escape")
    page.get_by_label("Speed").select_option("100")
    press("Run")
    expect(state(page, "Off")).to_have_class(re.compile("current"))
    press("Pause")
    with page.expect_download() as saved:
        press("Save as a test")
    assert saved.value.suggested_filename == "test_Lamp.py"
    assert "        'On',\n" in saved.value.path().read_text()
    press("Reset")
    expect(page.locator("#simulated")).to_have_text("0.000 s, in Off")
    press("End")
    expect(page.locator("#simulation")).to_be_hidden()
    expect(page.locator(".current, .taken")).to_have_count(0)
    assert seen.errors == []
