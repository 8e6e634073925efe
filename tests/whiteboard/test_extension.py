"""The extension agrees with its stub, and can be missing."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

RunPython = Callable[..., str]


def test_the_stub_matches_the_extension() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "mypy.stubtest", "llfsm.whiteboard._shm"],
        cwd=Path(__file__).parents[2],
        text=True,
        capture_output=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr


def test_without_the_extension_only_the_local_board_works(run_python: RunPython) -> None:
    script = """
import sys
sys.modules["llfsm.whiteboard._shm"] = None
from llfsm.whiteboard import SharedMemoryUnavailableError, Slot, Whiteboard
from llfsm.whiteboard.messages.std_msgs import Int64
try:
    Whiteboard("board")
except SharedMemoryUnavailableError as error:
    print(error)
with Whiteboard.local() as board:
    board.add_message(Slot("a", Int64), Int64(5))
    print(board.get_message(Slot("a", Int64)))
"""
    error, message = run_python(script).splitlines()
    assert "has no shared memory" in error
    assert "use Whiteboard.local()" in error
    assert message == "Int64(data=5)"
