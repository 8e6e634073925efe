"""A demo in one process: its parts are threads on a whiteboard of that process."""

from __future__ import annotations

import os
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, NamedTuple, Self

import click

from llfsm.bridges.turtlesim.node import TurtlesimNode
from llfsm.bridges.turtlesim.simulator import Simulator, run
from llfsm.runtime.plans.plan import assemble
from llfsm.runtime.presence.live import LiveEnvironment

from ..page import VIEW_PORT, listen, make_server, page_address
from ..run.arguments import parse_arguments
from .processes import ProcessStatus

if TYPE_CHECKING:
    from starlette.types import ASGIApp

    from llfsm.whiteboard import Board

__all__ = ["Threads"]


class _Part(NamedTuple):
    name: str
    started: float
    thread: threading.Thread
    stop: Callable[[], object]


class Threads:
    """Run the parts of a demo as threads; leaving the ``with`` block ends them, the last first.

    It shows its parts, and waits, as :class:`.Processes` does. An error in one of them is raised by
    `wait`.
    """

    def __init__(self, board: Board) -> None:
        self.reports: deque[str] = deque()
        self._board = board
        self._all: list[_Part] = []
        self._failed: deque[Exception] = deque()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        while self._all:
            part = self._all.pop()
            part.stop()
            part.thread.join()

    def start_simulator(self, simulator: Simulator) -> None:
        """Start a turtle simulator."""
        step, ending = TurtlesimNode(simulator, self._board).step, threading.Event()
        self._start("simulator", partial(run, step, ending.is_set), ending.set)

    def start_machines(self, names: Sequence[str]) -> None:
        """Start the machines of these names as one arrangement."""
        resolved = parse_arguments(names, None, (), ())
        environment = LiveEnvironment(self._board)
        arrangement = assemble(
            resolved.plan, resolved.classes, environment, library=resolved.library
        )
        self._start("machine", arrangement.run, partial(arrangement.stop, "the demo ends"))

    def start_page(self, token: str) -> str:
        """Serve the page of the whiteboard on this host; return its address."""
        from llfsm.bridges.view.live_source import LiveSource

        host = "127.0.0.1"
        source = LiveSource(self._board.name, given=self._board)

        def make_app(token: str) -> ASGIApp:
            from llfsm.bridges.view.app import make_app

            return make_app(source, host=host, token=token, control=False)

        server = make_server(make_app, token)
        try:
            listener = listen(host, VIEW_PORT)
        except click.ClickException:  # another page has it
            listener = listen(host, 0)
        self._start(
            "page",
            partial(server.run, sockets=[listener]),
            partial(setattr, server, "should_exit", True),
        )
        return page_address(host, listener.getsockname()[1], token)

    def statuses(self) -> list[ProcessStatus]:
        """Return the status of each part, in the order of their start."""
        now = time.monotonic()
        return [ProcessStatus(p.name, os.getpid(), now - p.started, "") for p in self._all]

    def wait(self, seconds: float) -> None:
        """Wait, and raise the error that has ended a part."""
        if self._failed:
            raise self._failed.popleft()
        time.sleep(seconds)  # between two looks of the screen

    def _start(self, name: str, run: Callable[[], object], stop: Callable[[], object]) -> None:
        def execute() -> None:
            try:
                run()
            except Exception as error:  # raised again where the demo waits
                self._failed.append(error)

        thread = threading.Thread(target=execute, name=name, daemon=True)
        self._all.append(_Part(name, time.monotonic(), thread, stop))
        thread.start()
