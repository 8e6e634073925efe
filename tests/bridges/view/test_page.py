"""The page in a real browser: what it shows is what is on the board."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import expect

from llfsm.bridges.recording.reader import Recording
from llfsm.whiteboard import Message, Slot, Whiteboard
from llfsm.whiteboard.messages.geometry_msgs import Twist, Vector3
from llfsm.whiteboard.messages.llfsm import MachineStatus, definition_slot, status_slot
from llfsm.whiteboard.messages.std_msgs import Bool
from llfsm.whiteboard.messages.turtlesim import Pose
from waiting import wait_for

from .conftest import Server

pytestmark = pytest.mark.timeout(240)

MACHINE = "[data-machine=RosPingPong]"


class Reading(Message):
    stamp: int
    volts: float
    name: str = ""
    parts: tuple[float, ...] = ()
    maybe: Bool | None = None


def test_a_demo_is_alive_and_a_click_suspends_a_machine(
    board: str, start: Callable[..., Any], visit: Callable[..., Any]
) -> None:
    start("turtlesim", "-b", board)
    start("run", "RosBlindTurttleBot", "-q", "-b", board)
    server = start(Server, board, "--control")
    seen = visit(server.address)
    page = seen.page
    card = page.locator("[data-machine=RosBlindTurttleBot]")

    # The state that is lit is the machine's, and the transition to it is lit with it.
    page.wait_for_selector("[data-machine] .current[data-state=STRAIGHT]")
    page.wait_for_selector("[data-machine] .fired[data-transition='STRAIGHT:0']")
    page.wait_for_selector("[data-machine] .current[data-state=TURN_RIGHT]")
    expect(card.locator(".variables")).to_contain_text("linear_x")

    # The token is not left in the address, and a reload needs none.
    assert "token" not in page.url
    page.reload()

    expect(card.locator(".pill")).to_have_text("running")
    card.locator("[data-action=suspend]").click()
    expect(card.locator(".pill")).to_have_text("suspended")
    expect(card.locator(".current")).to_have_count(0)
    expect(card.locator(".held")).to_have_count(1)
    expect(card.locator("[data-action=suspend]")).to_be_disabled()
    card.locator("[data-action=resume]").click()
    expect(card.locator(".pill")).to_have_text("running")
    expect(card.locator(".current")).to_have_count(1)

    expect(page.locator("#field-where")).to_contain_text("turtle1 at (")
    expect(page.locator("#field")).to_be_visible()
    assert seen.errors == []


def test_an_ended_machine_has_a_card_and_the_others_have_their_timelines(
    board: str, start: Callable[..., Any], visit: Callable[..., Any]
) -> None:
    with Whiteboard(board) as wb:
        wb.add_message(status_slot("Ended"), MachineStatus("somewhere", loaded=False))
        start("run", "RosPingPong", "-q", "-b", board)
        wait_for(lambda: wb[status_slot("RosPingPong")].count, "the machine runs")
        seen = visit(start(Server, board).address)
        page = seen.page
        expect(page.locator("[data-machine=Ended] .pill")).to_have_text("ended")
        expect(page.locator(f"{MACHINE} .pill")).to_have_text("running")
        # Its colours are in the last pixels, which are now; the page draws them ten times a second.
        seen.wait(
            f"""() => {{
                const canvas = document.querySelector("{MACHINE} .timeline");
                const probe = new OffscreenCanvas(16, 8);
                const drawing = probe.getContext("2d", {{ willReadFrequently: true }});
                drawing.drawImage(canvas, 20 - canvas.width, 8 - canvas.height);
                return drawing.getImageData(0, 0, 16, 8).data.some((value) => value > 0);
            }}"""
        )
        assert seen.errors == []


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


TWO = """
from llfsm.runtime import Actuator, Machine, State
from llfsm.whiteboard import Slot
from llfsm.whiteboard.messages.std_msgs import Int32

class Wall(Machine):
    drive = Actuator(Slot("cmd_vel", Int32))
    A = State()
    A.to(A, when=lambda m: False)

class Blind(Wall):
    pass
"""


def test_two_processes_that_command_a_slot_are_shown_until_one_ends(
    board: str, start: Callable[..., Any], visit: Callable[..., Any], tmp_path: Path
) -> None:
    (tmp_path / "two.py").write_text(TWO)
    first = start("run", "two:Wall", "-q", "-b", board)
    with Whiteboard(board) as wb:
        wait_for(lambda: wb[status_slot("Wall")].count, "the first runs")
    seen = visit(start(Server, board).address)
    contested = seen.page.locator("#contested")
    seen.page.wait_for_selector("[data-machine=Wall]")
    expect(contested).to_be_hidden()
    second = start("run", "two:Blind", "-q", "-b", board)
    expect(contested).to_have_text(
        f"cmd_vel has two commanders: Wall (pid {first.popen.pid}), Blind (pid {second.popen.pid})"
    )
    expect(seen.page.locator("#trouble")).to_be_hidden()
    second.end()
    expect(contested).to_be_hidden()
    assert seen.errors == []


def test_a_slot_opens_to_its_value_and_its_schema(
    board: str, start: Callable[..., Any], visit: Callable[..., Any]
) -> None:
    slot = Slot("power/main", Reading)
    large = 1_800_000_000_123_456_789  # more than a double holds
    with Whiteboard(board) as wb:
        wb.add_message(slot, Reading(large, 12.625, "main", (1.0, float("nan")), Bool(True)))
        seen = visit(start(Server, board).address)
        page = seen.page
        row = page.locator("[data-slot='power/main']")
        row.locator(".line").click()
        for text in (str(large), "12.625", "main", "not a finite number", "true"):
            expect(row.locator(".tree").first).to_contain_text(text)
        expect(row.locator(".facts")).to_contain_text("1 added")
        wb.add_message(slot, Reading(2, 11.5, "spare"))
        expect(row.locator(".tree").first).to_contain_text("11.5")
        expect(row.locator(".tree").first).to_contain_text("empty")
        expect(row.locator(".facts")).to_contain_text("2 added")
        row.locator("button", has_text="Schema").click()
        expect(page.locator("#sheet pre")).to_contain_text('"title": "Reading"')
        page.keyboard.press("Escape")
        expect(row.locator("button", has_text="Post")).to_have_count(0)  # without --control
        assert seen.errors == []


def test_slots_are_filtered_and_pinned_with_the_keyboard(
    board: str, start: Callable[..., Any], visit: Callable[..., Any]
) -> None:
    with Whiteboard(board) as wb:
        for name in ("arm/left", "arm/right", "base/velocity"):
            wb.add_message(Slot(name, Twist), Twist())
        page = visit(start(Server, board).address).page
        names = page.locator("#rows .group:not(.own .group) .slot")
        expect(names).to_have_count(3)
        page.keyboard.press("/")
        page.keyboard.type("ARM twist")
        expect(names).to_have_count(2)
        expect(page.locator("#board-number")).to_have_text("2 of 3")
        page.locator("#board-filter").fill("nothing like it")
        expect(page.locator("#board-empty")).to_be_visible()
        page.locator("#board-filter").fill("")
        page.keyboard.press("Escape")
        page.locator("[data-slot='arm/left'] .line").focus()
        page.keyboard.press("ArrowDown")
        page.keyboard.press("ArrowDown")
        page.keyboard.press("p")
        expect(page.locator(".group.pinned .slot")).to_have_attribute("data-slot", "base/velocity")
        page.keyboard.press("Enter")
        expect(page.locator("[data-slot='base/velocity'] .tree").first).to_be_visible()
        page.reload()
        expect(page.locator(".group.pinned .slot")).to_have_count(1)
        page.keyboard.press("?")
        expect(page.locator("#keys")).to_be_visible()


def test_a_machine_is_folded_found_and_filled_the_window_with(
    board: str, start: Callable[..., Any], visit: Callable[..., Any]
) -> None:
    start("run", "RosPingPong", "-q", "-b", board)
    page = visit(start(Server, board).address).page
    card = page.locator(MACHINE)
    diagram = card.locator(".diagram")
    expect(diagram).to_be_visible()
    card.locator(".fold").click()
    expect(diagram).to_be_hidden()
    page.keyboard.press("f")
    expect(diagram).to_be_visible()

    page.keyboard.press("m")
    page.keyboard.type("count")
    expect(card.locator(".found")).to_have_attribute("data-state", "WAIT_AND_COUNT")
    page.keyboard.press("Control+a")
    page.keyboard.type("nobody")
    expect(page.locator("#machines-empty")).to_be_visible()
    expect(card).to_be_hidden()
    page.locator("#machines-search").fill("")
    page.keyboard.press("Escape")

    diagram.focus()
    before = card.locator("svg[role=img]").get_attribute("viewBox")
    page.keyboard.press("+")
    assert card.locator("svg[role=img]").get_attribute("viewBox") != before
    page.keyboard.press("ArrowLeft")
    page.keyboard.press("0")
    assert card.locator("svg[role=img]").get_attribute("viewBox") == before
    page.keyboard.press("Enter")
    box = card.bounding_box()
    assert box is not None
    assert box["width"] > 1200
    page.keyboard.press("Escape")
    expect(card).not_to_have_class("card large")

    card.locator("button", has_text="Code").click()
    expect(card.locator(".diagram .code").first).to_be_visible()


def test_a_value_is_posted_with_a_form_made_of_the_schema(
    board: str, start: Callable[..., Any], visit: Callable[..., Any]
) -> None:
    slot = Slot("base/velocity", Twist)
    with Whiteboard(board) as wb:
        wb.add_message(slot, Twist(linear=Vector3(x=1.5)))
        seen = visit(start(Server, board, "--control").address)
        page = seen.page
        row = page.locator("[data-slot='base/velocity']")
        row.locator(".line").click()
        row.locator("button", has_text="Post").click()
        inputs = page.locator("#sheet input[type=number]")
        expect(inputs).to_have_count(6)
        expect(inputs.first).to_have_value("1.5")
        inputs.nth(5).fill("-0.25")
        page.locator("#sheet button", has_text="Post").click()
        wait_for(lambda: wb[slot].count == 2, "the message was posted")
        assert wb.get_message(slot) == Twist(linear=Vector3(x=1.5), angular=Vector3(z=-0.25))
        assert seen.errors == []


def test_the_page_comes_back_when_the_server_does(
    board: str, start: Callable[..., Any], visit: Callable[..., Any]
) -> None:
    slot = Slot("lamp", Bool)
    with Whiteboard(board) as wb:
        wb.add_message(slot, Bool(False))
        server = start(Server, board)
        page = visit(server.address).page
        value = page.locator("[data-slot=lamp] .short")
        expect(value).to_have_text("data false")
        server.end()
        expect(page.locator("#link")).to_have_attribute("data-is", "lost")
        expect(page.locator("#trouble")).to_be_visible()
        expect(value).to_have_text("data false")  # what was there last stays
        wb.add_message(slot, Bool(True))
        start(Server, board, port=server.port)
        expect(page.locator("#link")).to_have_attribute("data-is", "live")
        expect(page.locator("#trouble")).to_be_hidden()
        expect(value).to_have_text("data true")


def test_a_board_may_come_go_and_come_again(
    board: str, start: Callable[..., Any], visit: Callable[..., Any]
) -> None:
    seen = visit(start(Server, board).address)
    page = seen.page
    expect(page.locator("#trouble")).to_contain_text("no whiteboard")
    with Whiteboard(board) as wb:
        wb.add_message(Slot("first", Bool), Bool(True))
        expect(page.locator("[data-slot=first] .short")).to_have_text("data true")
        expect(page.locator("#trouble")).to_be_hidden()
        wb.remove()
    expect(page.locator("#trouble")).to_contain_text("was removed")
    expect(page.locator("[data-slot=first]")).to_be_visible()
    with Whiteboard(board) as wb:
        wb.add_message(Slot("second", Pose), Pose(x=1.0))
        expect(page.locator("[data-slot=second] .short")).to_contain_text("x 1")
        expect(page.locator("[data-slot=first]")).to_have_count(0)
        expect(page.locator("#trouble")).to_be_hidden()
    assert seen.errors == []


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_the_theme_is_the_systems_until_it_is_chosen(
    board: str, start: Callable[..., Any], visit: Callable[..., Any], theme: str
) -> None:
    page = visit(start(Server, board).address, color_scheme=theme).page
    root = page.locator("html")
    expect(root).to_have_attribute("data-theme", theme)
    page.keyboard.press("t")
    other = "dark" if theme == "light" else "light"
    expect(root).to_have_attribute("data-theme", other)
    page.reload()
    expect(root).to_have_attribute("data-theme", other)


def test_a_recording_has_a_slider_over_all_that_the_page_shows(
    board: str, start: Callable[..., Any], visit: Callable[..., Any], tmp_path: Path
) -> None:
    counter, definition = Slot("counter", Reading), definition_slot("RosPingPong")
    start("run", "RosPingPong", "-q", "-b", board)
    with Whiteboard(board) as wb:
        wb.add_message(counter, Reading(0, 0.0))
        status = wb[status_slot("RosPingPong")]
        wait_for(lambda: status.count, "the machine runs")
        record = start("record", "-o", "run.mcap", "-b", board)
        record.line()
        file, number = tmp_path / "run.mcap", 0
        waited = wait_for(lambda: any(Recording(file).messages([definition.name])))
        begin = time.monotonic()
        while time.monotonic() - begin < 1 + 5 * waited:  # in most of it the machine is to be seen
            number += 1
            wb.add_message(counter, Reading(number, number / 2))
            time.sleep(0.01)
        record.end()
    server = start(Server, board, str(file))
    seen = visit(server.address)
    page = seen.page
    value = page.locator("[data-slot=counter] .short")
    slider = page.locator("#slider")

    def shown() -> int:
        return int((value.text_content() or "stamp -1").split()[1])

    def length() -> float:
        return float(slider.get_attribute("max") or 0)

    wait_for(lambda: length() > 1, "the slider has the length of the recording")
    end = length()
    slider.fill(str(end))
    wait_for(lambda: shown() > number / 2, "the end was shown")
    page.wait_for_selector(f"{MACHINE} [data-state]")
    slider.fill(str(end / 4))
    wait_for(lambda: 0 <= shown() < number / 2, "an early moment was shown")
    expect(page.locator(f"{MACHINE} .current")).to_have_count(1)
    expect(page.locator("#link")).to_have_text("recording")

    early = shown()
    page.locator("#play").click()
    wait_for(lambda: shown() > early + 5, "it played")
    page.wait_for_selector(f"{MACHINE} .fired")
    assert seen.errors == []


def test_of_two_ways_to_a_state_the_one_that_was_taken_is_lit(
    board: str, start: Callable[..., Any], visit: Callable[..., Any], tmp_path: Path
) -> None:
    (tmp_path / "twin.py").write_text(
        "from llfsm.runtime import Machine, State\n"
        "class Twin(Machine):\n"
        "    a, b, c, rest = State(), State(), State(), State()\n"
        "    a.to(rest, when=lambda m: m.after_ms(600))\n"
        "    rest.to(b, when=lambda m: m.after_ms(10**9))\n"
        "    rest.to(b, when=lambda m: m.after_ms(600))\n"
        "    b.to(c)\n"
        "    c.to(a)\n"
    )
    start("run", "twin:Twin", "-q", "-b", board)
    page = visit(start(Server, board).address).page
    page.wait_for_selector(".fired[data-transition='a:0']")
    # b is too short to be seen: it has come from c, which is lit, and not from what was seen.
    page.wait_for_selector(".fired[data-transition='c:0']")
    assert page.locator("[data-transition='rest:0'].fired").count() == 0
    changes = page.evaluate(
        "new Promise((done) => { const socket = new WebSocket(`ws://${location.host}/live`);"
        " const skipped = []; socket.onmessage = ({data}) => { const frame = JSON.parse(data);"
        " for (const each of Object.values(frame.history ?? {}).flat()) skipped.push(each);"
        ' if (skipped.length > 8) done(skipped); else socket.send(\'{"type": "seen"}\'); } })'
    )
    ways = {(state, source, number) for _, state, _, source, number, *_ in changes if source}
    assert ways <= {("rest", "a", 0), ("b", "rest", 1), ("c", "b", 0), ("a", "c", 0)}
    assert any(skipped for *_, skipped, _ in changes)
