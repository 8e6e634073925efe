"""Waiting for any slot of a board, and adding only on top of what is known; asked of each kind."""

from __future__ import annotations

import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from llfsm.whiteboard import Board, BoardClosedError, Message, Slot, Whiteboard


class Point(Message):
    x: float = 0.0


SLOTS = [Slot(f"point{i}", Point) for i in range(40)]


@pytest.fixture(params=["shared", "local"])
def board(request: pytest.FixtureRequest, tmp_path: Path) -> Board:
    if request.param == "shared":
        return Whiteboard("board", directory=tmp_path)
    return Whiteboard.local()


def test_a_watcher_names_what_was_added_since(board: Board) -> None:
    watch = board.watcher()
    assert watch(0) == []
    for slot in SLOTS[:30]:
        board.add_message(slot, Point())
    assert watch(0) == [slot.name for slot in SLOTS[:30]]
    assert watch(0.001) == []
    for slot in (SLOTS[3], SLOTS[35], SLOTS[3]):
        board.add_message(slot, Point())
    assert watch(60) == [SLOTS[3].name, SLOTS[35].name]
    assert board.watcher()(0) == [slot.name for slot in (*SLOTS[:30], SLOTS[35])]


def test_a_watcher_is_woken_by_every_add(board: Board) -> None:
    """None is missed, however the add and the wait fall together."""
    ready = threading.Barrier(2)

    def add() -> None:
        for i in range(300):
            ready.wait()
            board.add_message(SLOTS[i % 40], Point(float(i)))

    watch = board.watcher()
    with ThreadPoolExecutor(1) as pool:
        adding = pool.submit(add)
        start = time.monotonic()
        for i in range(300):
            ready.wait()
            assert watch(60) == [SLOTS[i % 40].name]
        adding.result()
    assert time.monotonic() - start < 300 * 0.05  # else it was not woken, but looked by itself


def test_a_watcher_times_out(board: Board) -> None:
    board[SLOTS[0]]
    start = time.monotonic()
    assert board.watcher()(0.12) == []
    assert time.monotonic() - start >= 0.12


def test_a_watcher_ends_with_its_board(board: Board) -> None:
    watch = board.watcher()
    with ThreadPoolExecutor(1) as pool:
        waiting = pool.submit(watch, 60)
        board.close()
        with pytest.raises(BoardClosedError):
            waiting.result()


def test_a_message_is_added_after_a_count_or_not_at_all(board: Board) -> None:
    bound = board[SLOTS[0]]
    assert bound.add_after(Point(1.0), 1) == 0
    assert bound.add_after(Point(1.0), 0) == 1
    assert bound.add_after(Point(2.0), 0) == 0
    assert board.get_message(SLOTS[0]) == Point(1.0)
    assert bound.add(Point(2.0)) == 2
    assert bound.add_after(Point(3.0), 2) == 3
    assert bound.get() == Point(3.0)


def test_of_those_who_add_after_one_count_one_does(board: Board) -> None:
    bound = board[SLOTS[0]]

    def add(thread: int) -> int:
        return sum(bound.add_after(Point(float(thread)), count) > 0 for count in range(300))

    with ThreadPoolExecutor(4) as pool:
        added = list(pool.map(add, range(4)))
    assert sum(added) == bound.count
    assert bound.count > 0
