"""The slots that are read, which a daemon fetches from other hosts, and no others."""

from __future__ import annotations

import gc
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path

import pytest

from llfsm.whiteboard import Board, BoundSlot, Slot, Whiteboard
from llfsm.whiteboard.messages.std_msgs import Int64
from waiting import wait_for

NUMBER, OTHER = Slot("number", Int64), Slot("other", Int64)

READER = """
import os, sys
from llfsm.whiteboard import Slot, Whiteboard
from llfsm.whiteboard.messages.std_msgs import Int64
board = Whiteboard("board", directory=sys.argv[1])
board.get_message(Slot("number", Int64))
print("reads", flush=True)
sys.stdin.read()
"""


@pytest.fixture(autouse=True)
def _collected_soon() -> None:
    gc.freeze()  # so that a collection looks at what the test makes, and at nothing else


def wait_for_any(board: Board, bound: BoundSlot[Int64]) -> object:
    return board.waiter().wait({bound: bound.count}, 0)


@pytest.mark.parametrize(
    "read",
    [
        lambda _, bound: bound.get(),
        lambda _, bound: bound.sample(),
        lambda _, bound: bound.wait(after=bound.count, timeout=0),
        wait_for_any,
    ],
    ids=["get", "sample", "wait", "waiter"],
)
@pytest.mark.parametrize("messages", [0, 1])
def test_a_slot_is_read_from_its_first_read_until_its_last_handle_is_gone(
    board: Board, read: Callable[[Board, BoundSlot[Int64]], object], messages: int
) -> None:
    """Not by adding to it, or by looking at its bytes and count."""
    one, other = board.publisher(NUMBER), board.publisher(NUMBER)
    for _ in range(messages):
        one.add(Int64(1))
    assert one.count == messages
    one.encoded()
    one.recent()
    one.reserve()
    assert NUMBER.name not in board.read_slots()
    read(board, one)
    read(board, one)
    read(board, other)
    board.add_message(OTHER, Int64(2))
    assert NUMBER.name in board.read_slots()
    assert OTHER.name not in board.read_slots()
    del one
    gc.collect()
    assert NUMBER.name in board.read_slots()
    del other
    gc.collect()
    assert NUMBER.name not in board.read_slots()


def test_a_forgotten_slot_is_not_read(board: Board) -> None:
    board.get_message(NUMBER)
    board.forget(NUMBER)
    gc.collect()
    assert NUMBER.name not in board.read_slots()


def test_a_first_read_ends_a_watch(board: Board) -> None:
    """At once, not after its time."""
    watch, returned = board.watcher(), threading.Event()
    board.add_message(NUMBER, Int64(1))
    while watch(0):
        pass

    def run() -> None:
        while NUMBER.name not in board.read_slots():
            watch(600)
        returned.set()

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    board.get_message(NUMBER)
    assert returned.wait(60)
    thread.join()


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_a_process_that_dies_reads_no_more(tmp_path: Path, number: signal.Signals) -> None:
    with Whiteboard("board", directory=tmp_path) as board:
        for _ in range(2):
            with subprocess.Popen(
                [sys.executable, "-c", READER, str(tmp_path)],
                stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
            ) as process:  # fmt: skip
                assert process.stdout is not None
                assert process.stdout.readline() == "reads\n"
                assert board.read_slots() == {NUMBER.name}
                process.send_signal(number)
            assert board.read_slots() == set()


def test_a_child_reads_what_it_does_itself_and_keeps_what_it_has_got(tmp_path: Path) -> None:
    """Whatever it or its parent ends, the other's reading stays."""
    with Whiteboard("board", directory=tmp_path) as board, open_again(tmp_path) as judge:
        board.get_message(NUMBER)
        child = os.fork()
        if not child:
            board.forget(NUMBER)
            board.get_message(OTHER)
            signal.pause()
        try:
            wait_for(lambda: OTHER.name in judge.read_slots())
            assert NUMBER.name in judge.read_slots()
            board.forget(NUMBER)
            gc.collect()
            assert judge.read_slots() == {OTHER.name}
        finally:
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
        assert judge.read_slots() == set()


def open_again(directory: Path) -> Whiteboard:
    return Whiteboard("board", directory=directory)


def test_reading_goes_with_the_name_not_with_its_room(tmp_path: Path) -> None:
    with Whiteboard("board", directory=tmp_path) as board:
        board.get_message(NUMBER)
        bound = board[NUMBER]
        board.vacate(NUMBER)
        board.add_message(OTHER, Int64(1))  # in the same room
        assert bound.get() is None
        assert board.read_slots() == set()
        bound.add(Int64(2))
        assert bound.get() == Int64(2)
        assert board.read_slots() == {NUMBER.name}


def test_a_thousand_readers_that_come_and_go_leave_nothing_behind(board: Board) -> None:
    for _ in range(1000):
        board.publisher(NUMBER).get()
    gc.collect()
    assert NUMBER.name not in board.read_slots()


def test_a_closed_board_reads_nothing(tmp_path: Path) -> None:
    with open_again(tmp_path) as judge:
        with Whiteboard("board", directory=tmp_path) as board:
            bound = board[NUMBER]
            bound.get()
            assert judge.read_slots() == {NUMBER.name}
        assert judge.read_slots() == set()
        del bound
        assert judge.read_slots() == set()
