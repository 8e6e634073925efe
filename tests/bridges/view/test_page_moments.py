"""Moments of a recording on the page in a real browser: links and events lead to them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import expect

from llfsm.bridges.recording.writer import RecordingWriter
from llfsm.whiteboard import Sample, Slot
from llfsm.whiteboard.messages.llfsm import MachineRequest, MachineStatus, request_slot, status_slot
from llfsm.whiteboard.messages.std_msgs import Int32

from .conftest import Server

pytestmark = pytest.mark.timeout(240)

S = 1_000_000_000
TICKS = {  # on axes of so many seconds, with room for so many
    (-60, 0, 6): ["-1:00", "-50 s", "-40 s", "-30 s", "-20 s", "-10 s", "0 s"],
    (0, 10, 4): ["0 s", "5 s", "10 s"],
    (0, 0.3, 9): ["0.00 s", "0.05 s", "0.10 s", "0.15 s", "0.20 s", "0.25 s", "0.30 s"],
    (0, 100, 4): ["0 s", "30 s", "1:00", "1:30"],
    (0, 9000, 3): ["0 s", "1:00:00", "2:00:00"],
    (0, 0, 5): ["0.000 s"],
}


def record(file: Path) -> None:
    """A counter of tenths of seconds for 10 s, and a machine that goes and fails."""
    with RecordingWriter(file, {"board": "test"}) as writer:
        for i in range(101):
            stamp_ns = writer.begin_ns + i * S // 10
            writer.add(Slot("counter", Int32), Sample(Int32(i), i + 1, stamp_ns, 1))
            state, since = ("WAIT", i) if i < 40 else ("GO", i - 40)
            failed = i >= 80
            error = "GO, OnEntry: <b>no</b> plan" if failed else ""
            status = MachineStatus(
                state, suspended=failed, failed=failed, error=error, in_state_s=since / 10, pid=1
            )
            writer.add(status_slot("Patrol"), Sample(status, i + 1, stamp_ns, 1))
            if i == 85:
                request = MachineRequest("resume")
                writer.add(request_slot("Patrol"), Sample(request, 1, stamp_ns, 2))


def test_a_link_leads_to_a_moment_and_has_no_token(
    board: str, start: Callable[..., Any], visit: Callable[..., Any], tmp_path: Path
) -> None:
    record(tmp_path / "run.mcap")
    server = start(Server, board, str(tmp_path / "run.mcap"))
    seen = visit(server.address + "#t=3.25", permissions=["clipboard-read", "clipboard-write"])
    page = seen.page
    counter = page.locator("[data-slot=counter] .short")
    expect(counter).to_have_text("data 32")
    expect(page.locator("#at")).to_have_text("3.3 s")
    expect(page).to_have_url(f"{server.root}/")

    legend = page.locator("[data-machine=Patrol] .legend")
    expect(legend.locator("span span")).to_have_text(["WAIT", "GO", "(failed)"])
    ticks = "([a, b, most]) => import('/assets/ticks.js').then((m) => m.ticks(a, b, most))"
    for (begin, end, most), labels in TICKS.items():
        assert [text for _, text in page.evaluate(ticks, [begin, end, most])] == labels

    page.locator("#slider").fill("7.5")
    expect(counter).to_have_text("data 75")
    page.locator("#moment").click()
    expect(page.locator("#toasts")).to_contain_text("copied")
    link = page.evaluate("navigator.clipboard.readText()")
    assert link == f"{server.root}/#t=7.5"

    # The log has what happened until then, and leads to it.
    page.keyboard.press("e")
    rows = page.locator("#log-table tr")
    expect(rows.locator("td:last-child")).to_have_text(["in GO", "in WAIT"])
    page.locator("#slider").fill("9")
    expect(rows.first).to_contain_text("request: resume")
    expect(rows.nth(1)).to_contain_text("failed: GO, OnEntry: <b>no</b> plan")
    page.locator("#log-filter").fill("patrol plan")
    expect(rows).to_have_count(1)
    page.locator("#log-filter").fill("wait")
    expect(rows).to_contain_text(["in WAIT"])
    page.locator("#log-filter").fill("")
    page.locator("#log-table button", has_text="8 s").click()
    expect(counter).to_have_text("data 80")

    # What differs between a marked moment and the one that is shown.
    page.keyboard.press("k")
    changes = page.locator("#changes-table tr")
    expect(page.locator("#changes-head")).to_have_text("Changes from 8.0 s")
    expect(page.locator("#changes-empty")).to_be_visible()
    page.locator("#slider").fill("2")
    expect(changes).to_have_text(["counter.data80→20", "PatrolGO (failed)→WAIT"])
    page.locator("#slider").fill("8")
    expect(changes).to_have_count(0)
    page.locator("#changes-close").click()
    expect(page.locator("#changes")).to_be_hidden()

    page.evaluate("location.hash = 't=1e9x'")
    expect(page.locator("#toasts [data-is=problem]")).to_contain_text("#t=1e9x is no time")
    page.evaluate("location.hash = 't=1'")
    expect(counter).to_have_text("data 10")
    assert seen.errors == []

    # Without the token it leads nowhere.
    other = visit(link).page
    expect(other.locator("#trouble")).to_contain_text("it contains the token")
    expect(other.locator("[data-slot]")).to_have_count(0)
