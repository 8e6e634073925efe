from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from llfsm.whiteboard import Board, Whiteboard

OpenBoard = Callable[[], Board]
RunPython = Callable[..., str]


@pytest.fixture(params=["shared", "local"])
def open_board(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[OpenBoard]:
    """Open the test's board of each kind: every call is one more handle on the same board.

    A kind that has no second handle returns the first again.
    """
    with ExitStack() as handles:
        if request.param == "shared":
            yield lambda: handles.enter_context(Whiteboard("board", directory=tmp_path))
        else:
            board = handles.enter_context(Whiteboard.local("board"))
            yield lambda: board


@pytest.fixture
def board(open_board: OpenBoard) -> Board:
    return open_board()


@pytest.fixture
def run_python() -> RunPython:
    """Run code in a process of its own, which must end well; return what it printed."""

    def run(code: str, *arguments: object) -> str:
        command = [sys.executable, "-c", code, *map(str, arguments)]
        done = subprocess.run(command, text=True, capture_output=True, timeout=60, check=False)
        assert done.returncode == 0, f"exit status {done.returncode}\n{done.stdout}{done.stderr}"
        return done.stdout

    return run
