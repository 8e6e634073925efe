"""The promises of a board, kept by every kind."""

from __future__ import annotations

import math
import os
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from itertools import chain
from typing import Annotated

import msgspec
import pytest

from growth import growth_of
from llfsm.whiteboard import (
    Board,
    BoardClosedError,
    BoundSlot,
    Message,
    MessageFieldError,
    Slot,
    SlotRetiredError,
    SlotTypeError,
)
from waiting import PATIENCE_S

OpenBoard = Callable[[], Board]


class Point(Message, type_name="test/Point"):
    x: float = 0.0
    y: float = 0.0


class Path(Message):
    name: str = ""
    start: Point = Point()
    points: tuple[Point, ...] = ()
    number: Annotated[int, msgspec.Meta(ge=0, le=9)] = 0


POINT = Slot("robot/point", Point)
PATH = Slot("robot/path", Path)


def test_nothing_was_added_yet(board: Board) -> None:
    point = board[POINT]
    assert board.get_message(POINT) is None
    assert point.get() is None
    assert point.sample() is None
    assert point.count == 0


def test_a_slot_for_each_message_needs_no_memory(board: Board) -> None:
    def use(times: int) -> None:
        for x in range(times):
            board.add_message(Slot("robot/point", Point), Point(x=float(x)))
            assert board.get_message(Slot("robot/point", Point)) == Point(x=float(x))

    assert board[Slot("robot/point", Point)] is board[POINT]
    use(50)
    assert growth_of(lambda: use(300)) < 150


class SamePoint(Message, type_name="test/Point"):
    """Another class of the same type, as one that is made from a definition."""

    x: float = 0.0
    y: float = 0.0


class Other(Message, type_name="test/Other"):
    x: float = 0.0
    y: float = 0.0


def test_a_message_of_another_class_of_the_type_is_one_of_the_slot(board: Board) -> None:
    same = Slot("robot/point", SamePoint)
    board.add_message(POINT, SamePoint(x=1.0))
    assert board.get_message(POINT) == Point(x=1.0)
    board.add_message(same, Point(x=2.0))
    assert board.get_message(same) == SamePoint(x=2.0)
    assert board[POINT].add_after(SamePoint(x=3.0), 2) == 3
    for wrong in (Other(x=1.0), SamePoint(x="far"), 3):
        with pytest.raises((SlotTypeError, MessageFieldError)):
            board.add_message(POINT, wrong)
    assert board[POINT].count == 3


def test_a_compare_and_swap_adds_only_after_the_latest(board: Board) -> None:
    point = board[POINT]
    assert point.add_after(Point(x=1.0), 0) == 1
    assert point.add_after(Point(x=2.0), 1) == 2
    for count in (0, 1, 3):
        assert point.add_after(Point(x=9.0), count) == 0
    assert point.get() == Point(x=2.0)


def test_reserving_adds_nothing(board: Board) -> None:
    point = board[POINT]
    for count in (0, 1):
        point.reserve()
        assert point.count == count
        point.add(Point())
    board.close()
    with pytest.raises(BoardClosedError):
        point.reserve()


def test_the_latest_message_is_got(board: Board) -> None:
    for x in range(20):
        board.add_message(POINT, Point(x=float(x)))
        assert board.get_message(POINT) == Point(x=float(x))
        assert board[POINT].get() == Point(x=float(x))


def test_a_message_as_its_bytes(board: Board) -> None:
    point = board[POINT]
    assert point.encoded() is None
    for x in range(3):
        point.add(Point(x=float(x)))
        encoded, sample = point.encoded(), point.sample()
        assert encoded is not None
        assert sample is not None
        data, *rest = encoded
        assert msgspec.msgpack.decode(data) == [float(x), 0.0]
        assert rest == list(sample[1:])
    board.close()
    with pytest.raises(BoardClosedError):
        point.encoded()


def test_slots_do_not_disturb_each_other(board: Board) -> None:
    slots = [Slot(f"point{i}", Point) for i in range(10)]
    for i, slot in enumerate(slots):
        for _ in range(i + 1):
            board.add_message(slot, Point(x=float(i)))
    assert [board[slot].count for slot in slots] == list(range(1, 11))
    assert [board.get_message(slot) for slot in slots] == [Point(x=float(i)) for i in range(10)]


def test_an_unchanged_message_is_the_same_object(board: Board) -> None:
    board.add_message(PATH, Path(points=(Point(1.0),)))
    first = board.get_message(PATH)
    assert first is not None
    assert board.get_message(PATH) is first
    sample = board[PATH].sample()
    assert sample is not None
    assert sample.message is first
    board.add_message(PATH, Path(points=(Point(1.0),)))
    assert board.get_message(PATH) is not first
    assert board.get_message(PATH) == first


def test_a_message_is_read_as_its_decoder_makes_it(board: Board) -> None:
    points = [Point(x=1)]
    board.add_message(PATH, Path(points=points))  # type: ignore[arg-type]
    points.append(Point())
    path = board.get_message(PATH)
    assert path == Path(points=(Point(x=1.0),))
    assert isinstance(path.points, tuple)
    assert isinstance(path.points[0].x, float)


def test_add_returns_the_count(board: Board) -> None:
    point = board[POINT]
    for count in range(1, 50):
        assert point.add(Point()) == count
        assert point.count == count
        sample = point.sample()
        assert sample is not None
        assert sample.count == count


def test_each_add_of_each_thread_has_a_count_of_its_own(board: Board) -> None:
    def add(thread: int) -> list[int]:
        return [board.add_message(POINT, Point(float(thread), float(i))) for i in range(200)]

    with ThreadPoolExecutor(4) as pool:
        counts = list(pool.map(add, range(4)))
    assert all(mine == sorted(mine) for mine in counts)
    assert sorted(chain.from_iterable(counts)) == list(range(1, 801))
    assert board[POINT].count == 800


def test_a_sample_has_its_time_and_its_writer(board: Board) -> None:
    point = board[POINT]
    before = time.monotonic_ns()
    for _ in range(20):
        point.add(Point())
        sample = point.sample()
        assert sample is not None
        assert before <= sample.stamp_ns <= time.monotonic_ns()
        assert sample.writer == os.getpid()
        before = sample.stamp_ns


def test_handles_of_one_board_see_the_same(open_board: OpenBoard) -> None:
    one, other = open_board(), open_board()
    for count, handle in enumerate((one, other, one, other, other, one), 1):
        assert handle.add_message(POINT, Point(float(count))) == count
        for reader in (one, other):
            sample = reader[POINT].wait(after=count - 1, timeout=PATIENCE_S)
            assert sample is not None
            assert (sample.message, sample.count) == (Point(float(count)), count)


def test_a_slot_bound_twice_is_one_slot(board: Board) -> None:
    assert board[POINT] is board[POINT]
    again = Slot("robot/point", Point, capacity=64)
    board.add_message(POINT, Point(1.0))
    assert board.get_message(again) == Point(1.0)
    assert board.add_message(again, Point(2.0)) == 2
    assert board.get_message(POINT) == Point(2.0)
    assert board[again].capacity == POINT.capacity
    assert len(board.slots()) == 1


def test_bound_slots_are_of_the_interface(board: Board) -> None:
    assert isinstance(board[POINT], BoundSlot)


def test_slots_are_listed_as_they_were_made(board: Board) -> None:
    assert board.slots() == []
    for slot in (PATH, POINT):
        board.add_message(slot, slot.type())
    assert board.slots() == [
        ("robot/path", "Path", PATH.schema, PATH.capacity, ""),
        ("robot/point", "test/Point", POINT.schema, POINT.capacity, ""),
    ]


def test_threads_bind_one_slot(board: Board) -> None:
    ready = threading.Barrier(4)

    def bind(thread: int) -> int:
        ready.wait()
        return sum(board.add_message(Slot(f"s{i}", Point), Point()) > 0 for i in range(50))

    with ThreadPoolExecutor(4) as pool:
        assert list(pool.map(bind, range(4))) == [50] * 4
    assert sorted(info.name for info in board.slots()) == sorted(f"s{i}" for i in range(50))
    assert all(board[Slot(f"s{i}", Point)].count == 4 for i in range(50))


# ---- Waiting --------------------------------------------------------------------------------


def test_wait_returns_at_once_if_a_newer_message_is_there(board: Board) -> None:
    point = board[POINT]
    point.add(Point(1.0))
    point.add(Point(2.0))
    for after in (0, 1):
        for timeout in (None, 0, -1, math.inf):
            sample = point.wait(after=after, timeout=timeout)
            assert sample is not None
            assert sample.message == Point(2.0)
            assert sample == point.sample()


@pytest.mark.parametrize("timeout", [0, -1, 0.03])
def test_wait_times_out_and_not_before(board: Board, timeout: float) -> None:
    board.add_message(POINT, Point())
    start = time.monotonic()
    assert board[POINT].wait(after=1, timeout=timeout) is None
    assert time.monotonic() - start >= timeout


@pytest.mark.parametrize("timeout", [None, 60, math.inf])
def test_wait_ends_when_another_thread_adds(board: Board, timeout: float | None) -> None:
    ping, pong = board[POINT], board[PATH]

    def answer() -> None:
        for count in range(50):
            asked = ping.wait(after=count, timeout=timeout)
            assert asked is not None
            pong.add(Path(start=asked.message))

    with ThreadPoolExecutor(1) as pool, board:  # closed first, so that a failure does not hang
        done = pool.submit(answer)
        for count in range(50):
            ping.add(Point(float(count)))
            answered = pong.wait(after=count, timeout=60)
            assert answered is not None
            assert answered.message.start == Point(float(count))
        done.result()


def test_all_who_wait_are_woken(board: Board) -> None:
    with ThreadPoolExecutor(5) as pool:
        waiting = [pool.submit(board[POINT].wait, after=0, timeout=60) for _ in range(5)]
        board.add_message(POINT, Point(3.0))
        for found in waiting:
            sample = found.result()
            assert sample is not None
            assert sample.message == Point(3.0)


def test_wait_count_waits_alike_and_returns_the_number(board: Board) -> None:
    slot = board[POINT]
    with ThreadPoolExecutor(1) as pool:
        count = pool.submit(slot.wait_count, after=0, timeout=60)
        slot.add(Point())
        assert count.result() == 1
    slot.add(Point())
    assert slot.wait_count(after=0, timeout=0) == 2
    assert slot.wait_count(after=2, timeout=0.01) is None
    board.close()
    with pytest.raises(BoardClosedError):
        slot.wait_count(after=0)


def test_wait_asks_for_a_count_by_name(board: Board) -> None:
    with pytest.raises(TypeError, match="positional argument"):
        board[POINT].wait(1)  # type: ignore[call-arg]
    with pytest.raises(TypeError, match="after"):
        board[POINT].wait()  # type: ignore[call-arg]
    with pytest.raises(TypeError):
        board[POINT].wait(after=0, timeout="1")  # type: ignore[arg-type]


def test_a_publisher_that_was_retired_adds_no_more_and_hinders_nobody(board: Board) -> None:
    shared, mine, other = board[POINT], board.publisher(POINT), board.publisher(POINT)
    add = mine.add
    assert (add(Point(1.0)), shared.add(Point(2.0)), other.add(Point(3.0))) == (1, 2, 3)
    mine.retire()
    mine.retire()
    for retired in (add, mine.add, lambda message: mine.add_after(message, 3)):
        with pytest.raises(SlotRetiredError, match="slot 'robot/point': this handle was retired"):
            retired(Point(4.0))
    assert mine.get() == Point(3.0)
    assert (shared.add(Point(5.0)), other.add(Point(6.0))) == (4, 5)
    assert mine.count == 5


def test_the_latest_message_is_among_the_recent_ones(board: Board) -> None:
    point = board[POINT]
    assert point.recent() == []
    for x in range(9):
        board.publisher(POINT).add(Point(x=float(x)))
    latest = point.sample()
    assert latest is not None
    recent = point.recent()
    assert max(recent) == (latest.count, latest.stamp_ns, latest.writer)
    assert len(recent) <= 4
    assert {writer for _, _, writer in recent} == {os.getpid()}
