"""Real `llfsm view` servers on boards and ports of their own, and a real browser."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from playwright.sync_api import Browser, Page, expect, sync_playwright
from websockets.sync.client import ClientConnection, connect

from forked import Forked
from own_boards import own_board
from programs import program
from waiting import PATIENCE_S, rest_of

expect.set_options(timeout=PATIENCE_S * 1000)


class Process:
    """An `llfsm` command that runs until it is ended."""

    def __init__(self, *arguments: str, cwd: Path, **environment: str) -> None:
        self.popen = Forked(
            [sys.executable, "-m", "llfsm.cli", *arguments],
            cwd=cwd,
            env={**os.environ, **environment},
            text=True,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
        )

    def line(self) -> str:
        assert self.popen.stdout is not None
        return self.popen.stdout.readline()

    def end(self, how: int = signal.SIGTERM) -> tuple[int, str]:
        """Return the exit status and what was printed since the last line that was read."""
        if self.popen.poll() is None:
            self.popen.send_signal(how)
        printed = rest_of(self.popen)
        return self.popen.returncode, printed


class Server(Process):
    """`llfsm view` on a free port, or one that is given."""

    def __init__(
        self, board: str, *options: str, cwd: Path, port: int = 0, **environment: str
    ) -> None:
        arguments = ("view", "-b", board, "--no-open", "--port", str(port), *options)
        super().__init__(*arguments, cwd=cwd, **environment)
        printed = self.line()
        found = re.search(r"at (http://[^/]+:(\d+)/(\?token=\S+))", printed)
        assert found, printed + self.end()[1]
        self.address, self.port, self.query = found[1], int(found[2]), found[3]
        self.root = f"http://127.0.0.1:{self.port}"

    def get(
        self, path: str, query: str | None = None, machine: str = "", **options: Any
    ) -> httpx.Response:
        """Request a path, with the token unless another `query` is given."""
        address = self.root + path + (self.query if query is None else query)
        address += f"&machine={machine}" if machine else ""
        # Without `verify=False`, each request would read the system's certificates.
        return httpx.get(address, trust_env=False, verify=False, timeout=PATIENCE_S, **options)

    def live(
        self,
        query: str | None = None,
        origin: str | None = "",
        at: str = "/live",
        **options: Any,
    ) -> ClientConnection:
        """Connect as the page does; `query` and `origin` are its own unless given."""
        return connect(
            f"ws://127.0.0.1:{self.port}{at}{self.query if query is None else query}",
            origin=self.root if origin == "" else origin,  # type: ignore[arg-type]
            max_size=None,
            proxy=None,
            **options,
        )


@pytest.fixture
def board() -> Iterator[str]:
    with own_board() as name:
        yield name


@pytest.fixture
def start(tmp_path: Path, board: str) -> Iterator[Callable[..., Any]]:
    """Start processes that end before the board: `start(Server, board)`, `start("run", ...)`."""
    started: list[Process] = []

    def start(*arguments: Any, **options: Any) -> Process:
        kind = Process if isinstance(arguments[0], str) else arguments[0]
        rest = arguments if kind is Process else arguments[1:]
        started.append(kind(*rest, cwd=tmp_path, **options))
        return started[-1]

    yield start
    for process in reversed(started):
        process.end()


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    path = program("chromium")
    with sync_playwright() as playwright:
        # As root, and in most containers, it has no sandbox of its own.
        browser = playwright.chromium.launch(executable_path=path, args=["--no-sandbox"])
        yield browser
        browser.close()


class Visit:
    """A page that was opened, and what it complained of."""

    def __init__(self, page: Page, address: str) -> None:
        self.page = page
        self.errors: list[str] = []
        page.set_default_timeout(PATIENCE_S * 1000)
        page.on("pageerror", lambda error: self.errors.append(str(error)))
        page.on("console", self._note)
        page.goto(address)

    def _note(self, message: Any) -> None:
        if message.type in ("error", "warning"):
            self.errors.append(message.text)

    def wait(self, script: str) -> None:
        """Wait until a JavaScript expression holds."""
        self.page.wait_for_function(script)


@pytest.fixture
def visit(browser: Browser) -> Iterator[Callable[..., Visit]]:
    """Open an address in a page with nothing remembered."""
    contexts = []

    def visit(address: str, **options: Any) -> Visit:
        context = browser.new_context(viewport={"width": 1280, "height": 900}, **options)
        contexts.append(context)
        return Visit(context.new_page(), address)

    yield visit
    for context in contexts:
        context.close()
