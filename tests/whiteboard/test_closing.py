"""A board that one thread closes while another one waits on it is not read any more."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

pytest.importorskip("llfsm.whiteboard._shm", reason="the extension is hidden")

SCRIPT = """
import sys, threading
from llfsm.whiteboard import Slot, Whiteboard, WhiteboardError
from llfsm.whiteboard.messages.std_msgs import Int64

directory, wait = sys.argv[1:]
number = Slot("number", Int64)

def follow(slot, count):
    try:
        while True:
            count = max(count, getattr(slot, wait)(after=count) and slot.count)
    except WhiteboardError as error:
        found.append(type(error).__name__)

found = []
for turn in range(300):
    with Whiteboard("board", directory=directory) as other:
        board = Whiteboard("board", directory=directory)
        thread = threading.Thread(target=follow, args=(board[number], board[number].count))
        thread.start()
        other.add_message(number, Int64(turn))
        board.close()
        thread.join()
print(*set(found), len(found))
"""


@pytest.mark.parametrize("wait", ["wait", "wait_count"])
def test_a_message_and_the_closing_end_a_wait_at_the_same_time(
    tmp_path: Path, run_python: Callable[..., str], wait: str
) -> None:
    """The memory on which the thread waited may not be mapped any more when it goes on."""
    assert run_python(SCRIPT, tmp_path, wait) == "BoardClosedError 300\n"
