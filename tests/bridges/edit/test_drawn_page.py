"""RosBlindTurttleBot is drawn from nothing, and does what the one that ships does."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest
from playwright.sync_api import expect

import llfsm.machines
from llfsm.bridges.turtlesim.node import TurtlesimNode
from llfsm.bridges.turtlesim.simulator import STEP_NS, Simulator
from llfsm.runtime import Arrangement, ManualClock, Trace
from llfsm.runtime.bundles import Bundle, BundleState, load_bundle, read_bundle, write_bundle
from llfsm.runtime.engine.table import MachineLayout, StateBox
from llfsm.whiteboard import Whiteboard
from waiting import wait_for

from ..view.conftest import Visit, browser, visit  # noqa: F401
from .test_edit_page import drag, middle, open_page, state, write  # noqa: F401

pytestmark = pytest.mark.timeout(240)

NAME = "RosBlindTurttleBot"
SHIPPED = Path(llfsm.machines.__file__).parent / f"{NAME}.machine"


def trace_of(folder: Path) -> list[object]:
    """Run a bundle beside the simulator; return what happened, and where the turtle was."""
    trace, board, clock, simulator = Trace(), Whiteboard.local(), ManualClock(), Simulator()
    node, poses = TurtlesimNode(simulator, board), list[object]()
    machine = load_bundle(folder)
    arrangement = Arrangement([machine], whiteboard=board, clock=clock, observers=[trace])
    for _ in range(10_000_000_000 // STEP_NS):
        arrangement.round()
        node.step()
        poses.append(simulator.turtle("turtle1").pose)
        clock.advance(ns=STEP_NS)
    arrangement.end()
    return [*trace, *poses]


def test_a_machine_is_drawn_from_nothing(
    tmp_path: Path,
    open_page: Callable[[Path], Visit],  # noqa: F811
) -> None:
    folder, shipped = tmp_path / f"{NAME}.machine", read_bundle(SHIPPED)
    empty = Bundle(
        NAME, (BundleState("First"),), layout=MachineLayout({"First": StateBox(0, 0, 120, 60)})
    )
    write_bundle(empty, folder)
    seen = open_page(folder)
    page = seen.page

    state(page, "First").click()
    page.keyboard.press("F2")
    page.keyboard.type("INITIAL")
    page.keyboard.press("Enter")
    state(page, "INITIAL").wait_for()
    x, y = middle(state(page, "INITIAL"))
    for name, dx, dy in (("STRAIGHT", 0, 130), ("TURN_RIGHT", -180, 230), ("END", 180, 230)):
        page.mouse.dblclick(x + dx, y + dy)
        expect(page.locator("#name")).to_have_value(re.compile(r"State_\d"))
        page.locator("#name").fill(name)
        page.keyboard.press("Enter")
        state(page, name).wait_for()

    for each in shipped.states:
        for transition in each.transitions:
            before = page.locator("[data-transition].label").count()
            state(page, each.name).click()
            handle = page.locator("[data-handle=new]")
            drag(page, middle(handle), middle(state(page, transition.target)))
            expect(page.locator("[data-transition].label")).to_have_count(before + 1)
            assert transition.expression is not None
            expect(page.locator(".transitions .selected .cm-content")).to_be_focused()
            page.keyboard.type(transition.expression.text.strip())
            page.keyboard.press("Escape")
            page.keyboard.press("Escape")
        for part, text in each.sections.items():
            state(page, each.name).click()
            write(page, f"{each.name}|{part}", text.text.rstrip("\n"))
    while not page.locator("[data-place='|Includes']").count():
        page.keyboard.press("Escape")  # one may only close the completions, whenever they come
    for part, declared in (
        ("Includes", shipped.includes),
        ("Variables", shipped.variables),
        ("Methods", shipped.methods),
    ):
        assert declared is not None
        write(page, f"|{part}", declared.text.rstrip("\n"))

    def is_written() -> bool:
        made = read_bundle(folder)
        return (made.states, made.variables, made.includes, made.methods) == (
            *(shipped.states, shipped.variables, shipped.includes, shipped.methods),
        )

    wait_for(is_written, "the machine is written")
    expect(page.locator("#findings")).to_have_text("No findings.")
    assert trace_of(folder) == trace_of(SHIPPED)
    assert seen.errors == []
