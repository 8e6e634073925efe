"""The page of a recording in a real browser: a slider over all that the page shows."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import expect

from llfsm.bridges.recording.reader import Recording
from llfsm.whiteboard import Slot, Whiteboard
from llfsm.whiteboard.messages.llfsm import definition_slot, status_slot
from llfsm.whiteboard.messages.std_msgs import Int32
from waiting import wait_for

from .conftest import Server

pytestmark = pytest.mark.timeout(240)

MACHINE = "[data-machine=RosPingPong]"


def test_a_recording_has_a_slider_over_all_that_the_page_shows(
    board: str, start: Callable[..., Any], visit: Callable[..., Any], tmp_path: Path
) -> None:
    counter, definition = Slot("counter", Int32), definition_slot("RosPingPong")
    start("run", "RosPingPong", "-q", "-b", board)
    with Whiteboard(board) as wb:
        wb.add_message(counter, Int32())
        status = wb[status_slot("RosPingPong")]
        wait_for(lambda: status.count, "the machine runs")
        record = start("record", "-o", "run.mcap", "-b", board)
        record.line()
        file, number = tmp_path / "run.mcap", 0
        waited = wait_for(lambda: any(Recording(file).messages([definition.name])))
        begin = time.monotonic()
        while time.monotonic() - begin < 1 + 5 * waited:  # in most of it the machine is to be seen
            number += 1
            wb.add_message(counter, Int32(data=number))
            time.sleep(0.01)
        record.end()
    server = start(Server, board, str(file))
    seen = visit(server.address)
    page = seen.page
    value = page.locator("[data-slot=counter] .short")
    slider = page.locator("#slider")

    def shown() -> int:
        return int((value.text_content() or "data -1").split()[1])

    def length() -> float:
        return float(slider.get_attribute("max") or 0)

    wait_for(lambda: length() > 1, "the slider has the length of the recording")
    end = length()
    slider.fill(str(end))
    wait_for(lambda: shown() > number / 2, "the end was shown")
    last = shown()
    page.wait_for_selector(f"{MACHINE} [data-state]")
    slider.fill(str(end / 4))
    wait_for(lambda: 0 <= shown() < last, "an early moment was shown")
    expect(page.locator(f"{MACHINE} .current")).to_have_count(1)
    expect(page.locator("#link")).to_have_text("recording")
    # The values of its guards are known without its code, once they have any in this state.
    value_of_guard, moment = page.locator(f"{MACHINE} .why [data-is]"), end / 4

    def move_on() -> None:
        nonlocal moment
        moment = moment + 0.01 if moment < end / 2 else 0
        slider.fill(str(moment))

    wait_for(lambda: value_of_guard.count(), "a guard has a value", between=move_on)

    early = shown()
    page.locator("#play").click()
    wait_for(lambda: shown() > early + 5, "it played")
    page.wait_for_selector(f"{MACHINE} .fired")
    assert seen.errors == []
