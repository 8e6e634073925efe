"""Take the screenshots in docs/ that show the pages: `make screenshots`."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from playwright.sync_api import Browser, Error, Page, sync_playwright

DOCS = Path(__file__).parents[1] / "docs"
BUNDLES = Path(__file__).parents[1] / "machines"
MACHINE = "RosWallTurttleBot"
ROUND_S = 30  # about once along all walls


@contextmanager
def opened(browser: Browser, folder: str, *command: str, **size: int) -> Iterator[Page]:
    """Run a command of llfsm that prints the address of its page, and open that."""
    server = subprocess.Popen(
        [sys.executable, "-m", "llfsm.cli", *command],
        cwd=folder, text=True, stdout=subprocess.PIPE,
    )  # fmt: skip
    try:
        assert server.stdout is not None
        lines = (re.search(r"http://\S+", line) for line in server.stdout)
        address = next(filter(None, lines), None)
        assert address, f"llfsm {command[0]} has not started"
        page = browser.new_page(viewport={"width": size["width"], "height": size["height"]})
        for left in range(100, -1, -1):  # the demo prints the address before its page is there
            try:
                page.goto(address[0])
                break
            except Error:
                if not left:
                    raise
                page.wait_for_timeout(100)
        yield page
        page.close()
    finally:
        server.terminate()
        server.wait()


def edit(browser: Browser, folder: str) -> None:
    """Open a copy of a machine that ships, make a mistake, and wait until it is found."""
    shutil.copytree(BUNDLES / f"{MACHINE}.machine", Path(folder, f"{MACHINE}.machine"))
    command = ("edit", MACHINE, "--no-open", "--port", "0")
    with opened(browser, folder, *command, width=1280, height=820) as page:
        page.locator("[data-state=TURN_RIGHT]").click()
        page.locator("[data-place='TURN_RIGHT|OnExit'] .cm-content").click()
        page.keyboard.insert_text("move(0.0, angular)")
        page.locator("#findings .finding").wait_for()
        page.locator("[data-place='TURN_RIGHT|OnExit'] .cm-lint-marker-error").wait_for()
        page.screenshot(path=DOCS / "edit.png")


def view(browser: Browser, folder: str) -> None:
    """Watch the demo of a turtle between walls, with a slot unfolded, until it has been around."""
    command = ("demo", "wall", "--seconds", str(4 * ROUND_S), "--view")
    with opened(browser, folder, *command, width=1440, height=900) as page:
        page.get_by_text("turtle1/pose", exact=True).first.click()
        page.wait_for_timeout(1000 * ROUND_S)
        page.locator("[data-state=TURN_RIGHT].current").wait_for()
        page.screenshot(path=DOCS / "view.png")


def debug(browser: Browser, folder: str) -> None:
    """Pause the same demo where the turtle has met a wall, with what it saw then."""
    board = ("-b", "demo", "--directory", folder)
    demo = subprocess.Popen(
        [sys.executable, "-m", "llfsm.cli", "demo", "wall", *board],
        cwd=folder, stdout=subprocess.DEVNULL,
    )  # fmt: skip
    command = ("view", *board, "--control", "--no-open", "--port", "0")
    try:
        with opened(browser, folder, *command, width=1440, height=980) as page:
            breakpoint = page.get_by_label(f"New breakpoint of {MACHINE}")
            breakpoint.fill("BACK")
            breakpoint.press("Enter")
            page.locator(".why.before caption").wait_for()
            page.wait_for_timeout(1000)
            page.screenshot(path=DOCS / "debug.png")
    finally:
        demo.send_signal(signal.SIGINT)
        demo.wait()


def main() -> None:
    """Take all of them."""
    with sync_playwright() as playwright:
        path = os.environ.get("CHROMIUM") or shutil.which("chromium")
        browser = playwright.chromium.launch(executable_path=path, args=["--no-sandbox"])
        for take in (edit, view, debug):
            with tempfile.TemporaryDirectory() as folder:
                take(browser, folder)
        browser.close()


if __name__ == "__main__":
    main()
