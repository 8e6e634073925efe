"""Machines on the page in a real browser: their cards, diagrams and timelines show how they are."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace
from playwright.sync_api import expect

from llfsm.whiteboard import Whiteboard
from llfsm.whiteboard.liveness import born, host_name, pid_namespace
from llfsm.whiteboard.messages.llfsm import MachineStatus, status_slot
from waiting import wait_for

from .conftest import Server

pytestmark = pytest.mark.timeout(240)

MACHINE = "[data-machine=RosPingPong]"


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
    expect(card.locator(".variables:not(.sensors)")).to_contain_text("linear_x")

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


def test_an_ended_machine_is_folded_and_the_others_have_their_timelines(
    board: str, start: Callable[..., Any], visit: Callable[..., Any]
) -> None:
    with Whiteboard(board) as wb:
        wb.add_message(status_slot("Ended"), MachineStatus("somewhere", loaded=False))
        start("run", "RosPingPong", "-q", "-b", board)
        wait_for(lambda: wb[status_slot("RosPingPong")].count, "the machine runs")
        seen = visit(start(Server, board).address)
        page = seen.page
        ended = page.locator("[data-machine=Ended]")
        expect(ended.locator(".pill")).to_have_text("ended")
        expect(ended).to_have_attribute("data-folded", "true")
        expect(page.locator(f"{MACHINE} .pill")).to_have_text("running")
        expect(page.locator(MACHINE)).to_have_attribute("data-folded", "false")
        wb.add_message(status_slot("Ended"), MachineStatus("somewhere"))
        expect(ended).to_have_attribute("data-folded", "false")
        wb.add_message(status_slot("Ended"), MachineStatus("somewhere", loaded=False))
        expect(ended).to_have_attribute("data-folded", "true")
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


def test_a_submachine_is_under_its_caller_as_long_as_both_run(
    board: str, start: Callable[..., Any], visit: Callable[..., Any]
) -> None:
    run = MachineStatus(
        "A", pid=os.getpid(), born=born(os.getpid()), host=host_name(), namespace=pid_namespace()
    )
    with Whiteboard(board) as wb:

        def publish(name: str, caller: str = "", **how: Any) -> None:
            wb.add_message(status_slot(name), replace(run, caller=caller, **how))

        page = visit(start(Server, board).address).page

        def shows(*cards: tuple[str, str]) -> None:
            """Wait until the cards are these, in this order, each with its caller and indent."""
            expect(page.locator(".card h3")).to_have_text([name for name, _ in cards])
            expect(page.locator(".card .caller")).to_have_text(
                [text.strip() and f"called by {text.strip()}" for _, text in cards]
            )
            lefts = page.locator(".card").evaluate_all(
                "cards => cards.map((card) => card.getBoundingClientRect().left)"
            )
            depths = [len(text) - len(text.lstrip()) for _, text in cards]
            assert [round((left - lefts[0]) / 18) for left in lefts] == depths

        for name, caller in [("Boss", ""), ("Abel", "Work"), ("Work", "Boss"), ("Zed", "Gone")]:
            publish(name, caller)
        shows(("Boss", ""), ("Work", " Boss"), ("Abel", "  Work"), ("Zed", ""))
        publish("Boss", waits="door or 32 s")
        facts = page.locator("[data-machine=Boss] .facts")
        expect(facts).to_contain_text("waits for door or 32 s")
        publish("Work", "Boss", loaded=False)
        shows(("Abel", ""), ("Boss", ""), ("Zed", ""), ("Work", ""))
        publish("Boss", "Zed")  # and what no machines do: they call each other in a ring
        publish("Zed", "Boss")
        publish("Abel", "Abel")
        shows(("Abel", "Abel"), ("Boss", "Zed"), ("Zed", " Boss"), ("Work", ""))


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

    # All at once: what is beside the diagram, and with that its size, may change at any time.
    fit, near, left, back = diagram.evaluate(
        """diagram => ["0", "+", "ArrowLeft", "0"].map((key) => {
            diagram.dispatchEvent(new KeyboardEvent("keydown", { key, bubbles: true }));
            return diagram.querySelector("svg[role=img]").getAttribute("viewBox");
        })"""
    )
    assert len({fit, near, left}) == 3
    assert back == fit
    diagram.focus()
    page.keyboard.press("Enter")
    box = card.bounding_box()
    assert box is not None
    assert box["width"] > 1200
    page.keyboard.press("Escape")
    expect(card).not_to_have_class("card large")

    card.locator("button", has_text="Code").click()
    expect(card.locator(".diagram .code").first).to_be_visible()


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
        "new Promise((done) => { const token = sessionStorage.getItem('llfsm.token');"
        " const socket = new WebSocket(`ws://${location.host}/live?token=${token}`);"
        " const skipped = []; socket.onmessage = ({data}) => { const frame = JSON.parse(data);"
        " for (const each of Object.values(frame.history ?? {}).flat()) skipped.push(each);"
        ' if (skipped.length > 8) done(skipped); else socket.send(\'{"type": "seen"}\'); } })'
    )
    ways = {(state, source, number) for _, state, _, source, number, *_ in changes if source}
    assert ways <= {("rest", "a", 0), ("b", "rest", 1), ("c", "b", 0), ("a", "c", 0)}
    assert any(skipped for *_, skipped, _ in changes)


NESTED = """
from llfsm.runtime import Machine, State

class Wheel(Machine):
    slow, fast = State(), State(final=False)
    slow.to(fast, when=lambda self: self.is_suspended("Go"))

class Arm(Machine):
    lift = State(runs=Wheel, final=False)

class Mission(Machine):
    wait = State()
    work = State(runs=[Arm, Wheel])
    wait.to(work, when=lambda self: self.is_suspended("Go"))
    work.to(wait, when_done=True)

class Go(Machine):
    go = State(final=False)
"""


def test_what_a_state_runs_is_drawn_and_lit_inside_of_it(
    board: str, start: Callable[..., Any], visit: Callable[..., Any], tmp_path: Path
) -> None:
    (tmp_path / "nested.py").write_text(NESTED)
    names = [f"{tmp_path / 'nested.py'}:{name}" for name in ("Mission", "Go")]
    start("run", *names, "-q", "-b", board)
    seen = visit(start(Server, board, "--control").address)
    page = seen.page
    card, other = page.locator("[data-machine=Mission]"), page.locator("[data-machine=Go]")
    expect(card.locator(".diagram [data-state=work]")).to_contain_text("Arm")
    inner = card.get_by_role("button", name="Inner")
    expect(other.get_by_role("button", name="Inner")).to_be_hidden()  # it runs nothing
    inner.click()
    work = card.locator(".diagram [data-state=work]")
    expect(work.locator("[data-state]")).to_have_count(5)  # also what has not run yet
    expect(work.locator("[data-state].current")).to_have_count(0)
    other.locator("[data-action=suspend]").click()
    lit = work.locator("[data-state].current")
    expect(lit).to_have_count(3)
    page.wait_for_selector(
        "[data-machine=Mission] [data-state=lift].current [data-state=fast].current"
    )
    found = lit.evaluate_all("each => each.map(({ dataset }) => dataset.state)")
    assert found == ["lift", "fast", "fast"]
    card.locator("[data-action=suspend]").click()
    expect(lit).to_have_count(0)
    expect(work.locator("[data-state].held")).to_have_count(3)
    inner.click()
    expect(card.locator(".diagram [data-state]")).to_have_count(2)
    assert seen.errors == []
