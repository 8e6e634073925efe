"""Edit a machine of 200 states on a page and measure when that is seen; print it as JSON.

A sample is the nanoseconds from the key that makes an edit to the end of the frame in which the
browser has drawn it, with its arrows and labels, as the server has sent them. The browser draws
without a graphics card here.
"""

import argparse
import json
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

from llfsm.runtime.bundles import Bundle, BundleState, BundleTransition, Fragment, write_bundle
from llfsm.runtime.engine.table import MachineLayout, StateBox

STATES, COLUMNS = 200, 15
PAUSE_S = 0.6  # between edits, in which the machine is checked


def write_machine(folder: Path) -> None:
    """Write a machine of many states in a grid, each with two transitions."""
    names = [f"S{i}" for i in range(STATES)]
    states = tuple(
        BundleState(
            name,
            {"OnEntry": Fragment(f"count = {i}\n")},
            tuple(
                BundleTransition(names[(i + step) % STATES], Fragment(f"after_ms({i})\n"))
                for step in (1, 7)
            ),
        )
        for i, name in enumerate(names)
    )
    places = {
        name: StateBox(180.0 * (i % COLUMNS), 130.0 * (i // COLUMNS), 120, 60)
        for i, name in enumerate(names)
    }
    variables = Fragment("count: int = 0\n")
    write_bundle(Bundle("Big", states, variables=variables, layout=MachineLayout(places)), folder)


# Frames are drawn after their callbacks; the message comes when this one has been.
_WATCH = """([key, condition]) => {
    const holds = new Function(`return (${condition})`);
    window.seen = new Promise((resolve) => {
        let began = null;
        const note = (event) => {
            if (event.key !== key) return;
            began = event.timeStamp;
            removeEventListener("keydown", note, { capture: true });
        };
        addEventListener("keydown", note, { capture: true });
        const channel = new MessageChannel();
        channel.port1.onmessage = () => resolve((performance.now() - began) * 1e6);
        const look = () => {
            if (began !== null && holds()) channel.port2.postMessage(0);
            else requestAnimationFrame(look);
        };
        requestAnimationFrame(look);
    });
}"""
_OF = "document.querySelector('#drawing [data-state=\"{}\"]')"
_ARROW = "document.querySelector('#drawing [data-transition=\"{}\"]')"
_TO_DRAWING = "document.querySelector('#drawing .diagram').focus()"


def measure(times: int) -> dict[str, list[float]]:
    """Make each kind of edit so many times; return the samples of each."""
    from playwright.sync_api import sync_playwright

    found: dict[str, list[float]] = {}
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        machine = Path(folder, "Big.machine")
        write_machine(machine)
        command = [sys.executable, "-m", "llfsm.cli", "edit", str(machine), "--no-open"]
        with subprocess.Popen(
            [*command, "--port", "0"], stdout=subprocess.PIPE, text=True
        ) as server:
            try:
                assert server.stdout is not None
                address = re.search(r"http://\S+", server.stdout.readline())
                assert address
                browser = playwright.chromium.launch(
                    executable_path=shutil.which("chromium"), args=["--no-sandbox"]
                )
                page = browser.new_page(viewport={"width": 1440, "height": 900})
                page.goto(address[0])
                page.wait_for_selector("#drawing [data-state=S100]")
                box = page.locator("#drawing [data-state=S100] .box").bounding_box()
                assert box is not None
                page.mouse.click(box["x"] + 3, box["y"] + 3)  # labels may cover the rest

                def sample(
                    kind: str, press: str, condition: str, before: Callable[[], object]
                ) -> None:
                    before()
                    time.sleep(PAUSE_S)
                    page.evaluate(_WATCH, [press.rpartition("+")[2], condition])
                    page.keyboard.press(press)
                    found.setdefault(kind, []).append(page.evaluate("window.seen"))

                def to_drawing() -> object:
                    return page.evaluate(_TO_DRAWING)

                def write_name(name: str) -> None:
                    to_drawing()
                    page.keyboard.press("F2")
                    page.keyboard.insert_text(name)

                def to_targets() -> None:
                    to_drawing()
                    page.keyboard.press("c")
                    page.keyboard.press("ArrowDown")

                def write_wrong(name: str) -> None:
                    page.locator(".transitions .cm-content").first.click()
                    page.keyboard.press("Control+a")
                    page.keyboard.insert_text(name)

                def take_back() -> None:
                    to_drawing()
                    page.keyboard.press("Control+z")

                for _ in range(times):
                    place = f"{_OF.format('S100')}.querySelector('.box').getAttribute('x')"
                    was = page.evaluate(place)
                    sample("move", "ArrowRight", f"{place} !== {was!r}", to_drawing)
                for i in range(times):
                    write = partial(write_name, f"T{i}")
                    sample("rename", "Enter", _OF.format(f"T{i}"), write)
                for i in range(times):
                    drawn = _ARROW.format(f"T{times - 1}:{2 + i}")
                    sample("connect", "Enter", drawn, to_targets)
                for i in range(times):
                    shown = f"document.querySelector('#findings').textContent.includes('wrong{i}_')"
                    sample("check", "_", shown, partial(write_wrong, f"wrong{i}"))
                for i in range(1, times + 1):
                    sample("add", "n", _OF.format(f"State_{i}"), to_drawing)
                for i in range(times, 0, -1):
                    sample("undo", "Control+z", f"!{_OF.format(f'State_{i}')}", to_drawing)
                for i in range(times):
                    chosen = f"document.querySelector('#name')?.value === 'S{i}'"
                    sample("select", "Tab", chosen, to_drawing)
                place = f"{_OF.format('S150')}.querySelector('.box').getAttribute('x')"
                was = page.evaluate(place)
                for _ in range(times):
                    sample("arrange", "a", f"{place} !== {was!r}", to_drawing)
                    take_back()
                    page.wait_for_function(f"() => {place} === {was!r}")
                browser.close()
            finally:
                server.kill()
    return found


def main() -> None:
    """Do what the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--times", type=int, default=10)
    print(json.dumps(measure(parser.parse_args().times)))


if __name__ == "__main__":
    main()
