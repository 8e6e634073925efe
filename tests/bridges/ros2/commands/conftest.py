from __future__ import annotations

import itertools
import os
import queue
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress
from typing import Any

import pytest

from forked import Forked
from llfsm.bridges.ros2.zenoh_transport.transport import ZenohTransport
from llfsm.whiteboard import BoardNotFoundError, Whiteboard
from llfsm.whiteboard.board_files import remove_board
from waiting import PATIENCE_S

_NUMBERS = itertools.count(151)


class Running:
    """An `llfsm` command in a process of its own, and what it says."""

    def __init__(self, *arguments: str) -> None:
        self.process = Forked(
            [sys.executable, "-m", "llfsm.cli", *arguments],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            stdin=subprocess.DEVNULL,
            text=True,
            env=os.environ | {"PYTHONUNBUFFERED": "1"},
        )
        self.printed: list[str] = []
        self._lines: queue.SimpleQueue[str | None] = queue.SimpleQueue()
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self._lines.put(line)
        self._lines.put(None)

    def says(self, text: str) -> str:
        """Wait for a line with a text."""
        while True:
            line = self._lines.get(timeout=PATIENCE_S)
            assert line is not None, f"ended without {text!r}: {''.join(self.printed)}"
            self.printed.append(line)
            if text in line:
                return line

    def end(self, number: signal.Signals = signal.SIGTERM) -> int:
        """Send a signal; return the exit status."""
        self.process.send_signal(number)
        status = self.process.wait(PATIENCE_S)
        self._reader.join(PATIENCE_S)
        while (line := self._lines.get(timeout=PATIENCE_S)) is not None:
            self.printed.append(line)
        return status

    def close(self) -> None:
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait()
        self._reader.join()
        if self.process.stdout is not None:
            self.process.stdout.close()


@pytest.fixture
def domain() -> int:
    """Return a ROS domain that no other test uses."""
    return next(_NUMBERS)


@pytest.fixture
def board() -> Iterator[Whiteboard]:
    """Make a whiteboard for this test, and remove it."""
    name = f"test-bridge-{os.getpid()}-{next(_NUMBERS)}"
    with Whiteboard(name) as board:
        yield board
    with suppress(BoardNotFoundError):
        remove_board(name)


@pytest.fixture
def run(board: Whiteboard) -> Iterator[Callable[..., Running]]:
    """Run `llfsm` commands in processes that end before the test's board."""
    with ExitStack() as stack:

        def running(*arguments: str) -> Running:
            process = Running(*arguments)
            stack.callback(process.close)
            return process

        yield running


@pytest.fixture
def own_router(run: Callable[..., Running], free_port: int) -> Callable[[], Running]:
    """Start a router in a process; each time on the same endpoint."""

    def start() -> Running:
        router = run("router", "--listen", f"tcp/127.0.0.1:{free_port}")
        router.says("listening")
        return router

    return start


def where(board: Whiteboard, domain: int, router: str) -> list[str]:
    """Return the options of a bridge for these."""
    return f"--board {board.name} --domain {domain} --router {router} --transport zenoh".split()


@pytest.fixture
def bridge(
    run: Callable[..., Running], board: Whiteboard, domain: int, router: str
) -> Callable[..., Running]:
    """Start a bridge on the test's board, in its domain."""

    def start(*arguments: str, at: str = router) -> Running:
        process = run("bridge", *arguments, *where(board, domain, at))
        process.says("whiteboard")
        return process

    return start


@pytest.fixture
def peer(domain: int, router: str) -> Iterator[ZenohTransport]:
    """Open a transport of somebody else in the bridge's domain."""
    with ZenohTransport(domain, router=[router], notify=lambda _: None) as transport:
        yield transport


@pytest.fixture
def met(peer: ZenohTransport) -> Callable[..., None]:
    """Wait until the peer knows of so many nodes of the bridge."""

    def wait(*nodes: str) -> None:
        def ready(graph: Any) -> bool:
            return set(nodes) <= set(graph.nodes)

        assert peer.wait_graph(ready, PATIENCE_S), peer.graph()

    return wait
