"""The board of one process; what it shares with other kinds is in test_contract.py."""

from __future__ import annotations

import threading
import xml.etree.ElementTree as ET

import pytest

from llfsm.whiteboard import BoardClosedError, Slot, Whiteboard
from llfsm.whiteboard.messages.std_msgs import Int64, String
from waiting import PATIENCE_S

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
        thread.join(timeout=PATIENCE_S)
    assert ended == ["well"] * 4


def test_a_notebook_shows_slots_as_text_only() -> None:
    """Also those that hold what would be markup, or are long."""
    board = Whiteboard.local()
    board.add_message(Slot("text", String), String("<b>&" + "x" * 1000))
    board[Slot("empty", Int64)]
    rows = ET.fromstring(board._repr_html_())
    cells = [["".join(cell.itertext()) for cell in row] for row in rows][1:]
    assert [row[:3] for row in cells] == [
        ["text", "std_msgs/msg/String", "1"],
        ["empty", "std_msgs/msg/Int64", "0"],
    ]
    assert cells[0][3].startswith('{"data":"<b>&xxx')
    assert len(cells[0][3]) < 300
