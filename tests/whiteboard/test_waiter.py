"""Waiting for any of several slots; asked of each kind of board."""

from __future__ import annotations

import resource
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from llfsm.whiteboard import Board, BoardClosedError, Message, Slot, Whiteboard
from waiting import wait_for

from .conftest import mirrored


class Point(Message):
    x: float = 0.0


A, B, C = (Slot(name, Point) for name in "abc")
LONG_S = 600.0
"""Longer than a test may take: a wait that is not woken fails."""


@pytest.fixture(params=["shared", "local"])
def board(request: pytest.FixtureRequest, tmp_path: Path) -> Board:
    if request.param == "shared":
        return Whiteboard("board", directory=tmp_path)
    return Whiteboard.local()


@pytest.fixture
def shared(tmp_path: Path) -> Iterator[Whiteboard]:
    with Whiteboard("board", directory=tmp_path) as board:
        yield board


def test_it_returns_the_slots_that_are_newer(board: Board) -> None:
    a, b, c = board[A], board[B], board[C]
    for slot in (a, a, b):
        slot.add(Point())
    waiter = board.waiter()
    assert waiter.wait({a: 1, b: 1, c: 0}, LONG_S) == [a]
    seen = {a: 0, b: 0, c: 0}
    assert waiter.wait(seen, LONG_S) == [a, b]
    assert seen == {a: 2, b: 1, c: 0}
    assert waiter.wait(seen, 0.0) == []


def test_it_times_out(board: Board) -> None:
    start = time.monotonic()
    assert board.waiter().wait({board[A]: 0}, 0.12) == []
    assert board.waiter().wait({}, 0.001) == []
    assert time.monotonic() - start >= 0.12


def test_it_is_woken_by_every_add(board: Board) -> None:
    """None is missed, however the add and the wait fall together."""
    ready = threading.Barrier(2)
    slots = [board[A], board[B], board[C]]

    def add() -> None:
        for i in range(300):
            ready.wait()
            slots[i % 3].add(Point())

    waiter = board.waiter()
    seen = dict.fromkeys(slots, 0)
    with ThreadPoolExecutor(1) as pool:
        adding = pool.submit(add)
        start = time.monotonic()
        for i in range(300):
            ready.wait()
            assert waiter.wait(seen, LONG_S) == [slots[i % 3]]
        adding.result()
    assert time.monotonic() - start < 300 * 0.05  # else it was not woken, but looked by itself


def test_one_add_wakes_all_who_wait_for_it(board: Board) -> None:
    a, b, c = board[A], board[B], board[C]
    waits = [{a: 0, b: 0}, {c: 0, a: 0}, {a: 0}]
    with ThreadPoolExecutor(3) as pool:
        waiting = [pool.submit(board.waiter().wait, wait, LONG_S) for wait in waits]
        a.add(Point())
        assert [each.result() for each in waiting] == [[a]] * 3


def test_other_slots_do_not_wake_it(board: Board) -> None:
    a, b = board[A], board[B]
    begun = threading.Event()

    def wait() -> int:
        before = resource.getrusage(resource.RUSAGE_THREAD).ru_nvcsw
        begun.set()
        assert board.waiter().wait({a: 0}, LONG_S) == [a]
        return resource.getrusage(resource.RUSAGE_THREAD).ru_nvcsw - before

    with ThreadPoolExecutor(1) as pool:
        waiting = pool.submit(wait)
        begun.wait()
        for _ in range(5000):
            b.add(Point())
        a.add(Point())
        assert waiting.result() < 500


def test_it_can_be_woken_for_something_else(board: Board) -> None:
    waiter, a = board.waiter(), board[A]
    waiter.wake()
    assert waiter.wait({a: 0}, LONG_S) == []  # that was before
    with ThreadPoolExecutor(1) as pool:
        waiting = pool.submit(waiter.wait, {a: 0}, LONG_S)
        waiter.wake()
        assert waiting.result() == []
    assert waiter.wait({a: 0}, 0.001) == []


def test_it_can_be_woken_by_a_signal_handler(board: Board) -> None:
    """The handler runs in the thread that waits."""
    waiter = board.waiter()
    before = signal.signal(signal.SIGUSR1, lambda *_: waiter.wake())
    main = threading.main_thread().ident
    assert main is not None
    try:
        with ThreadPoolExecutor(1) as pool:
            sending = pool.submit(signal.pthread_kill, main, signal.SIGUSR1)
            assert waiter.wait({board[A]: 0}, LONG_S) == []
            sending.result()
    finally:
        signal.signal(signal.SIGUSR1, before)


def test_it_ends_with_its_board(board: Board) -> None:
    a = board[A]
    with ThreadPoolExecutor(1) as pool:
        waiting = pool.submit(board.waiter().wait, {a: 0}, LONG_S)
        board.close()
        with pytest.raises(BoardClosedError):
            waiting.result()
    with pytest.raises(BoardClosedError):
        board.waiter().wait({a: 0}, 0.0)


def test_a_handle_knows_what_it_has_added(board: Board) -> None:
    mine, others = board.publisher(A), board[A]
    assert mine.added == 0
    others.add(Point())
    assert (mine.add(Point()), mine.added, others.added) == (2, 2, 1)
    others.add(Point())
    assert mine.add_after(Point(), 2) == 0
    assert (mine.added, others.added) == (2, 3)


def test_what_a_mirror_enters_wakes_too(tmp_path: Path) -> None:
    with (
        mirrored(tmp_path) as endpoint,
        Whiteboard("board", directory=tmp_path) as there,
        Whiteboard.connect(endpoint, "board") as here,
        ThreadPoolExecutor(2) as pool,
    ):
        a, b = here[A], there[B]
        waiting = [
            pool.submit(here.waiter().wait, {a: 0}, LONG_S),
            pool.submit(there.waiter().wait, {b: 0}, LONG_S),
        ]
        there.add_message(A, Point())
        here.add_message(B, Point())
        assert [each.result() for each in waiting] == [[a], [b]]


def test_slots_of_another_board_are_refused(shared: Whiteboard, tmp_path: Path) -> None:
    with Whiteboard("other", directory=tmp_path) as other:
        with pytest.raises(TypeError, match="the board's own bound slots"):
            shared.waiter().wait({other[A]: 0}, LONG_S)
        with pytest.raises(TypeError):
            shared.waiter().wait({shared[A]: "1"}, LONG_S)  # type: ignore[dict-item]


WAIT = """
import sys
from llfsm.whiteboard import Message, Slot, Whiteboard

class Point(Message):
    x: float = 0.0

board = Whiteboard("board", directory=sys.argv[1])
a = board[Slot("a", Point)]
print("ready", flush=True)
print(board.waiter().wait({a: a.count}, 600) == [a], flush=True)
"""


def alarms(board: Whiteboard) -> int:
    """Count the times at which waiters for several slots were woken."""
    with board.path.open("rb") as file:
        file.seek(52)
        return int.from_bytes(file.read(4), "little")


def is_armed(board: Whiteboard) -> bool:
    """Check that the board's first slot may be one that somebody waits for."""
    with board.path.open("rb") as file:
        file.seek(448)
        file.seek(int.from_bytes(file.read(8), "little") + 76)
        return file.read(4) != bytes(4)


def start_waiting(board: Whiteboard) -> subprocess.Popen[str]:
    board[A]
    command = [sys.executable, "-c", WAIT, str(board.path.parent)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert process.stdout.readline() == "ready\n"
    wait_for(lambda: is_armed(board), "the slot is armed")
    return process


def test_an_add_wakes_another_process(shared: Whiteboard) -> None:
    process = start_waiting(shared)
    shared[A].add(Point())
    assert process.communicate() == ("True\n", None)


def test_a_killed_process_that_waited_costs_one_alarm(shared: Whiteboard) -> None:
    process = start_waiting(shared)
    process.kill()
    process.communicate()
    assert is_armed(shared)
    before = alarms(shared)
    for _ in range(100):
        shared[A].add(Point())
    assert alarms(shared) == before + 1
    assert not is_armed(shared)


def test_adds_for_which_nobody_waits_raise_no_alarm(shared: Whiteboard) -> None:
    process = start_waiting(shared)
    before = alarms(shared)
    for _ in range(100):
        shared[B].add(Point())
    assert alarms(shared) == before
    process.kill()
    process.communicate()
