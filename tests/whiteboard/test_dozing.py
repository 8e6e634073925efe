"""A sleep that is slept again and again, mostly to its end; what ends it is left to others."""

from __future__ import annotations

import gc
import signal
import sys
import threading
import time
import weakref
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from llfsm.whiteboard import Board, Message, Slot, Whiteboard

LONG_NS = 600_000_000_000
"""Longer than a test may take: a sleep that does not end early fails."""
NEVER_NS = 2**63 - 1


class Point(Message):
    x: float = 0.0


A, B = (Slot(name, Point) for name in "ab")


@pytest.fixture
def board(tmp_path: Path) -> Iterator[Whiteboard]:
    with Whiteboard("board", directory=tmp_path) as board:
        yield board


class Otherwise:
    """Keep when the sleeps were to end that did not."""

    def __init__(self) -> None:
        self.deadlines_ns: list[int] = []

    def __call__(self, deadline_ns: int) -> bool:
        self.deadlines_ns.append(deadline_ns)
        return False


@pytest.fixture
def otherwise() -> Otherwise:
    return Otherwise()


def test_it_sleeps_to_the_end_where_nothing_happens(
    board: Whiteboard, otherwise: Otherwise
) -> None:
    board[A].add(Point())
    doze = board.waiter().doze({board[A]: 1}, (), 60_000_000, NEVER_NS, otherwise)
    begin_ns = time.monotonic_ns()
    assert [doze(), doze()] == [True, True]
    assert time.monotonic_ns() - begin_ns >= 120_000_000  # longer than the protocol sleeps at once
    assert otherwise.deadlines_ns == []


@pytest.mark.parametrize("what", ["add", "wake", "close"])
@pytest.mark.parametrize("when", ["before", "meanwhile"])
def test_what_happens_is_left_to_others(
    board: Whiteboard, otherwise: Otherwise, what: str, when: str
) -> None:
    """They learn when the sleep was to end, unless none has begun, and find what it was."""
    waiter, seen = board.waiter(), {board[A]: 0, board[B]: 0}
    deeds: dict[str, Callable[[], object]] = {
        "add": lambda: board[B].add(Point()),
        "wake": waiter.wake,
        "close": board.close,
    }
    doze = waiter.doze(seen, (), LONG_NS, NEVER_NS, otherwise)
    begin_ns = time.monotonic_ns()
    thread = threading.Timer(0.0 if when == "before" else 0.02, deeds[what])
    thread.start()
    if when == "before":
        thread.join()
    assert doze() is False
    thread.join()
    (deadline_ns,) = otherwise.deadlines_ns
    if what == "close" and when == "before":
        assert deadline_ns == 0
    else:
        assert begin_ns + LONG_NS <= deadline_ns <= time.monotonic_ns() + LONG_NS
    if what != "close":
        assert waiter.wait(seen, LONG_NS / 1e9) == ([board[B]] if what == "add" else [])


def test_it_begins_none_when_its_time_is_over(board: Whiteboard, otherwise: Otherwise) -> None:
    until_ns = time.monotonic_ns()
    assert board.waiter().doze({}, (), LONG_NS, until_ns, otherwise)() is False
    assert otherwise.deadlines_ns == [0]


def test_what_the_process_adds_itself_is_no_news(board: Whiteboard, otherwise: Otherwise) -> None:
    mine, other = board.publisher(A), board.publisher(A)
    doze = board.waiter().doze({board[A]: 0}, ((board[A], mine),), 1_000_000, NEVER_NS, otherwise)
    for _ in range(3):
        mine.add(Point())
        assert doze() is True
    other.add(Point())
    assert doze() is False
    mine.add(Point())  # newer than that: all is known
    assert doze() is True


def test_a_board_that_was_removed_begins_none(
    board: Whiteboard, otherwise: Otherwise, tmp_path: Path
) -> None:
    doze = board.waiter().doze({board[A]: 0}, (), 1_000_000, NEVER_NS, otherwise)
    Whiteboard("board", directory=tmp_path).remove()
    assert doze() is False
    assert otherwise.deadlines_ns == [0]


def test_a_name_that_was_given_up_is_left_to_others(
    board: Whiteboard, otherwise: Otherwise, tmp_path: Path
) -> None:
    board[A].add(Point())
    doze = board.waiter().doze({board[A]: 1}, (), LONG_NS, NEVER_NS, otherwise)
    board.vacate(A)
    Whiteboard("board", directory=tmp_path).add_message(A, Point())
    assert doze() is False


def test_a_handler_of_a_signal_may_raise(board: Whiteboard, otherwise: Otherwise) -> None:
    def handle(*_: object) -> None:
        raise InterruptedError("by the handler")

    before = signal.signal(signal.SIGALRM, handle)
    signal.setitimer(signal.ITIMER_REAL, 0.02, 0.02)
    try:
        with pytest.raises(InterruptedError, match="by the handler"):
            board.waiter().doze({board[A]: 0}, (), LONG_NS, NEVER_NS, otherwise)()
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


def test_what_it_holds_can_be_released(board: Whiteboard) -> None:
    class Owner:
        def otherwise(self, deadline_ns: int) -> bool:
            return False

    owner: Any = Owner()
    owner.doze = board.waiter().doze({board[A]: 0}, (), 1, NEVER_NS, owner.otherwise)
    gone = weakref.ref(owner)
    references = sys.getrefcount(board[A])
    del owner
    gc.collect()
    assert gone() is None
    left = sys.getrefcount(board[A])
    assert left == references - 1


@pytest.mark.parametrize(
    "arguments",
    [
        ({1: 2}, (), 1, 1),
        ({}, (1,), 1, 1),
        ({}, ((1, 2),), 1, 1),
        ({}, [], 1, 1),
        ({}, (), 2**63, 1),
    ],
)
def test_what_cannot_be_is_refused(board: Whiteboard, arguments: tuple[Any, ...]) -> None:
    with pytest.raises((TypeError, ValueError, OverflowError)):
        board.waiter().doze(*arguments, bool)


def test_a_publisher_of_no_slot_that_it_waits_for_is_refused(board: Whiteboard) -> None:
    with pytest.raises(ValueError, match="readers that it waits for"):
        board.waiter().doze({board[A]: 0}, ((board[B], board[A]),), 1, 1, bool)


def test_a_board_of_one_process_leaves_all_to_others(otherwise: Otherwise) -> None:
    local: Board = Whiteboard.local()
    doze = local.waiter().doze({local[A]: 0}, (), LONG_NS, NEVER_NS, otherwise)
    assert doze() is False
    assert otherwise.deadlines_ns == [0]
