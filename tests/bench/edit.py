"""Edit a machine of 200 states on a page and measure when that is seen; print it as JSON.

A sample is the nanoseconds from the key that makes an edit to the end of the frame in which the
browser has drawn it, with its arrows and labels, as the server has sent them. The browser draws
without a graphics card here. How long that takes on this computer is shown by a script that copies
the drawing and moves a box.
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
from typing import Any

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


class Editor:
    """The page of a machine in a browser, and the samples of each kind of edit made there."""

    def __init__(self, page: Any) -> None:
        self.page = page
        self.samples: dict[str, list[float]] = {}

    def sample(self, kind: str, press: str, condition: str, before: Callable[[], object]) -> None:
        """Press a key, and take the time until a condition holds on the page."""
        before()
        time.sleep(PAUSE_S)
        self.page.evaluate(_WATCH, [press.rpartition("+")[2], condition])
        self.page.keyboard.press(press)
        self.samples.setdefault(kind, []).append(self.page.evaluate("window.seen"))

    def to_drawing(self) -> object:
        """Give the drawing the keyboard."""
        return self.page.evaluate(_TO_DRAWING)

    def write_name(self, name: str) -> None:
        """Write a state's new name."""
        self.to_drawing()
        self.page.keyboard.press("F2")
        self.page.keyboard.insert_text(name)

    def to_targets(self) -> None:
        """Choose among the targets of a new arrow."""
        self.to_drawing()
        self.page.keyboard.press("c")
        self.page.keyboard.press("ArrowDown")

    def write_wrong(self, name: str) -> None:
        """Write all but the end of a name that no variable has."""
        self.page.locator(".transitions .cm-content").first.click()
        self.page.keyboard.press("Control+a")
        self.page.keyboard.insert_text(name)

    def bare(self, times: int) -> None:
        """Copy the drawing and move a box by a script that does nothing else, so many times."""
        box = f"{_OF.format('S199')}.querySelector('.box')"
        self.page.evaluate(f"""() => addEventListener("keydown", (event) => {{
            if (event.key !== "F9") return;
            const drawing = document.querySelector("#drawing svg"), copy = drawing.cloneNode(true);
            drawing.after(copy);
            copy.getBoundingClientRect();
            copy.remove();
            {box}.setAttribute("x", 1 + Number({box}.getAttribute("x")));
        }})""")
        for _ in range(times):
            was = self.page.evaluate(f"{box}.getAttribute('x')")
            self.sample("bare", "F9", f"{box}.getAttribute('x') !== {was!r}", self.to_drawing)

    def edit(self, times: int) -> None:
        """Make each kind of edit so many times."""
        place = f"{_OF.format('S100')}.querySelector('.box').getAttribute('x')"
        for _ in range(times):
            was = self.page.evaluate(place)
            self.sample("move", "ArrowRight", f"{place} !== {was!r}", self.to_drawing)
        for i in range(times):
            self.sample("rename", "Enter", _OF.format(f"T{i}"), partial(self.write_name, f"T{i}"))
        for i in range(times):
            drawn = _ARROW.format(f"T{times - 1}:{2 + i}")
            self.sample("connect", "Enter", drawn, self.to_targets)
        for i in range(times):
            shown = f"document.querySelector('#findings').textContent.includes('wrong{i}_')"
            self.sample("check", "_", shown, partial(self.write_wrong, f"wrong{i}"))
        for i in range(1, times + 1):
            self.sample("add", "n", _OF.format(f"State_{i}"), self.to_drawing)
        for i in range(times, 0, -1):
            self.sample("undo", "Control+z", f"!{_OF.format(f'State_{i}')}", self.to_drawing)
        for i in range(times):
            chosen = f"document.querySelector('#name')?.value === 'S{i}'"
            self.sample("select", "Tab", chosen, self.to_drawing)
        place = f"{_OF.format('S150')}.querySelector('.box').getAttribute('x')"
        was = self.page.evaluate(place)
        for _ in range(times):
            self.sample("arrange", "a", f"{place} !== {was!r}", self.to_drawing)
            self.to_drawing()
            self.page.keyboard.press("Control+z")
            self.page.wait_for_function(f"() => {place} === {was!r}")


def measure(times: int) -> dict[str, list[float]]:
    """Make each kind of edit so many times; return the samples of each."""
    from playwright.sync_api import sync_playwright

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
                editor = Editor(page)
                editor.bare(times)
                editor.edit(times)
                browser.close()
            finally:
                server.kill()
    return editor.samples


def main() -> None:
    """Do what the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--times", type=int, default=10)
    print(json.dumps(measure(parser.parse_args().times)))


if __name__ == "__main__":
    main()
