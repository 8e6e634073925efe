"""Whose messages a slot's buffers hold, so who has added to it lately."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest

from llfsm.whiteboard import BoardClosedError, Slot, Whiteboard
from llfsm.whiteboard.messages.std_msgs import Int64

NUMBER = Slot("number", Int64)

SIX = """
import os, sys
from llfsm.whiteboard import Slot, Whiteboard
from llfsm.whiteboard.messages.std_msgs import Int64

with Whiteboard("board", directory=sys.argv[1]) as board:
    for i in range(6):
        board.add_message(Slot("number", Int64), Int64(i))
print(os.getpid())
"""


def test_up_to_four_messages_of_each_process_are_known(
    tmp_path: Path, run_python: Callable[..., str]
) -> None:
    with Whiteboard("board", directory=tmp_path) as board:
        number = board[NUMBER]
        assert number.recent() == []
        number.add(Int64(0))
        other = int(run_python(SIX, tmp_path))
        number.add(Int64(0))
        recent = sorted(number.recent())
    assert [count for count, _, writer in recent if writer == os.getpid()] == [1, 8]
    assert [count for count, _, writer in recent if writer == other] == [4, 5, 6, 7]
    stamps = [stamp for _, stamp, _ in recent]
    assert stamps == sorted(stamps)
    with pytest.raises(BoardClosedError):
        number.recent()
