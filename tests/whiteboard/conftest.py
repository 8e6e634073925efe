from __future__ import annotations

import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Generic

import pytest

from free_ports import free_endpoint
from llfsm.whiteboard import Board, BoundSlot, Sample, Whiteboard
from llfsm.whiteboard.message import M
from llfsm.whiteboard.messages.llfsm import BELL, Bell
from llfsm.whiteboard.mirror.daemon import daemon
from llfsm.whiteboard.mirror.settings import Settings

OpenBoard = Callable[[], Board]
RunPython = Callable[..., str]


class Observed(Generic[M]):
    """A slot that shows up to which message its reader has come: it waits for one after that."""

    def __init__(self, slot: BoundSlot[M]) -> None:
        self.after = -1
        self._slot = slot

    @property
    def count(self) -> int:
        return self._slot.count

    def wait(self, *, after: int, timeout: float | None = None) -> Sample[M] | None:
        self.after = after
        return self._slot.wait(after=after, timeout=timeout)


@pytest.fixture(params=["shared", "local", "connected"])
def open_board(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[OpenBoard]:
    """Open the test's board of each kind: every call is one more handle on the same board.

    A kind that has no second handle returns the first again.
    """
    with ExitStack() as handles:
        if request.param == "shared":
            yield lambda: handles.enter_context(Whiteboard("board", directory=tmp_path))
        elif request.param == "connected":
            endpoint = handles.enter_context(mirrored(tmp_path))
            connected = handles.enter_context(Whiteboard.connect(endpoint, "board"))
            yield lambda: connected
        else:
            board = handles.enter_context(Whiteboard.local("board"))
            yield lambda: board


@contextmanager
def mirrored(directory: Path) -> Iterator[str]:
    """Mirror a board in that folder from a thread; yield where it listens."""
    endpoint = free_endpoint()
    settings = Settings(listen=(endpoint,))
    with Whiteboard("board", directory=directory) as board, daemon(board, settings) as mirror:
        thread = threading.Thread(target=mirror.run)
        thread.start()
        yield endpoint
        mirror.stop()
        board.add_message(BELL, Bell())  # which wakes it
        thread.join()


@pytest.fixture
def board(open_board: OpenBoard) -> Board:
    return open_board()


@pytest.fixture
def run_python() -> RunPython:
    """Run code in a process of its own, which must end well; return what it printed."""

    def run(code: str, *arguments: object) -> str:
        command = [sys.executable, "-c", code, *map(str, arguments)]
        done = subprocess.run(command, text=True, capture_output=True, check=False)
        assert done.returncode == 0, f"exit status {done.returncode}\n{done.stdout}{done.stderr}"
        return done.stdout

    return run
