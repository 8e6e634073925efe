"""The board of one process; what it shares with other kinds is in test_contract.py."""

from __future__ import annotations

import threading

import pytest

from llfsm.whiteboard import BoardClosedError, Slot, Whiteboard
from llfsm.whiteboard.messages.std_msgs import Int64

NUMBER = Slot("number", Int64)


def test_every_local_board_is_another() -> None:
    with Whiteboard.local() as one, Whiteboard.local() as other:
        one.add_message(NUMBER, Int64(1))
        assert other.slots() == []
        assert other.get_message(NUMBER) is None


def test_closing_ends_the_wait_of_another_thread() -> None:
    board = Whiteboard.local()
    ready = threading.Barrier(5)
    ended: list[str] = []

    def wait(after: int) -> None:
        ready.wait()
        with pytest.raises(BoardClosedError, match="local: this whiteboard was closed"):
            board[NUMBER].wait(after=after)
        ended.append("well")

    threads = [threading.Thread(target=wait, args=(i,), daemon=True) for i in range(4)]
    for thread in threads:
        thread.start()
    ready.wait()
    board[NUMBER].wait(after=0, timeout=0.02)  # most of the threads wait by then
    board.close()
    for thread in threads:
        thread.join(timeout=30)
    assert ended == ["well"] * 4
