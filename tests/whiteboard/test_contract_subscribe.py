"""The promises of `subscribe`, on every kind of board."""

from __future__ import annotations

import logging
import queue
import threading
from collections.abc import Callable, Iterator

import pytest

from llfsm.whiteboard import Board, BoardClosedError, Message, Sample, Slot
from llfsm.whiteboard.subscription import Subscription
from waiting import PATIENCE_S, wait_for

from .conftest import Observed

OpenBoard = Callable[[], Board]


class Number(Message):
    value: int = 0


NUMBER = Slot("number", Number)
ANSWER = Slot("answer", Number)
Samples = queue.SimpleQueue[Sample[Number]]


@pytest.fixture(autouse=True)
def no_thread_is_left() -> Iterator[None]:
    before = set(threading.enumerate())
    yield
    wait_for(lambda: set(threading.enumerate()) <= before)


def counts(samples: Samples, number: int) -> list[int]:
    return [samples.get(timeout=PATIENCE_S).count for _ in range(number)]


class Gate:
    """A callback that blocks until it is opened, and records what it received."""

    def __init__(self) -> None:
        self.received: list[Sample[Number]] = []
        self.entered = threading.Event()
        self.open = threading.Event()

    def __call__(self, sample: Sample[Number]) -> None:
        self.received.append(sample)
        self.entered.set()
        assert self.open.wait(PATIENCE_S)


# ---- Delivery -------------------------------------------------------------------------------


@pytest.mark.parametrize("backlog", [1, 10])
def test_each_message_arrives_in_another_thread(board: Board, backlog: int) -> None:
    number = board[NUMBER]
    received: queue.SimpleQueue[tuple[Sample[Number], int]] = queue.SimpleQueue()
    with number.subscribe(
        lambda sample: received.put((sample, threading.get_ident())), backlog=backlog
    ) as subscription:
        for value in range(20):
            count = number.add(Number(value))
            sample, thread = received.get(timeout=PATIENCE_S)
            assert (sample.message, sample.count) == (Number(value), count)
            assert sample == number.sample()
            assert thread != threading.get_ident()
        assert subscription.active
        assert subscription.missed == 0
    assert not subscription.active
    assert received.empty()


@pytest.mark.parametrize("backlog", [1, 10])
def test_it_begins_with_what_is_there(board: Board, backlog: int) -> None:
    number = board[NUMBER]
    for value in range(5):
        number.add(Number(value))
    samples: Samples = queue.SimpleQueue()
    with number.subscribe(samples.put, backlog=backlog) as subscription:
        assert counts(samples, 1) == [5]
        assert subscription.missed == 0


@pytest.mark.parametrize(
    ("after", "first", "missed"), [(0, 5, 4), (3, 5, 1), (4, 5, 0), (5, 6, 0), (7, 8, 0)]
)
def test_or_after_a_message(board: Board, after: int, first: int, missed: int) -> None:
    number = board[NUMBER]
    for value in range(5):
        number.add(Number(value))
    samples: Samples = queue.SimpleQueue()
    with number.subscribe(samples.put, after=after, backlog=100) as subscription:
        while number.count < first:
            number.add(Number())
        assert counts(samples, 1) == [first]
        assert subscription.missed == missed


def test_a_busy_callback_gets_the_newest_next(board: Board) -> None:
    number, gate = board[NUMBER], Gate()
    with number.subscribe(gate) as subscription:
        number.add(Number(1))
        assert gate.entered.wait(PATIENCE_S)
        for value in range(2, 1001):
            number.add(Number(value))
        gate.open.set()
        wait_for(lambda: len(gate.received) == 2)
        assert [(s.message.value, s.count) for s in gate.received] == [(1, 1), (1000, 1000)]
        assert subscription.missed == 998


def test_a_backlog_delivers_every_observed_message_in_order(board: Board) -> None:
    number, gate = board[NUMBER], Gate()
    with number.subscribe(gate, backlog=1000) as subscription:
        number.add(Number(1))
        assert gate.entered.wait(PATIENCE_S)
        for value in range(2, 501):
            number.add(Number(value))
        gate.open.set()
        wait_for(lambda: gate.received[-1].count == 500)
        received = [sample.count for sample in gate.received]
        assert received == sorted(set(received))
        assert subscription.missed == 500 - len(received)


def test_messages_added_one_by_one_are_all_observed(board: Board) -> None:
    """Whoever adds waits until the message is in the backlog: then none is missed."""
    number, gate = board[NUMBER], Gate()
    observed = Observed(number)
    with Subscription(observed, gate, after=None, backlog=5, on_error=None) as subscription:
        number.add(Number(1))
        assert gate.entered.wait(PATIENCE_S)
        for value in range(2, 7):
            number.add(Number(value))
            wait_for(lambda value=value: observed.after == value)
        gate.open.set()
        wait_for(lambda: len(gate.received) == 6)
        assert [sample.count for sample in gate.received] == [1, 2, 3, 4, 5, 6]
        assert subscription.missed == 0


def test_a_full_backlog_loses_its_oldest_and_counts_them(board: Board) -> None:
    number, gate = board[NUMBER], Gate()
    observed = Observed(number)
    with Subscription(observed, gate, after=None, backlog=3, on_error=None) as subscription:
        number.add(Number(1))
        assert gate.entered.wait(PATIENCE_S)
        for value in range(2, 101):
            number.add(Number(value))
            wait_for(lambda value=value: observed.after == value)
        gate.open.set()
        wait_for(lambda: gate.received[-1].count == 100)
        assert [sample.count for sample in gate.received] == [1, 98, 99, 100]
        assert subscription.missed == 96


def test_each_subscription_of_a_slot_gets_each_message(open_board: OpenBoard) -> None:
    one, other = open_board()[NUMBER], open_board()[NUMBER]
    first, second, third = (queue.SimpleQueue() for _ in range(3))
    with one.subscribe(first.put), one.subscribe(second.put), other.subscribe(third.put):
        for value in range(1, 11):
            other.add(Number(value))
            for samples in (first, second, third):
                assert counts(samples, 1) == [value]


def test_a_callback_may_add_and_get(board: Board) -> None:
    number, answer = board[NUMBER], board[ANSWER]
    with number.subscribe(lambda sample: answer.add(Number(sample.message.value * 2))):
        for value in range(1, 11):
            number.add(Number(value))
            sample = answer.wait(after=value - 1, timeout=PATIENCE_S)
            assert sample is not None
            assert sample.message == Number(value * 2)


# ---- The end --------------------------------------------------------------------------------


@pytest.mark.parametrize("backlog", [1, 10])
def test_a_close_waits_for_the_callback_and_none_comes_after_it(board: Board, backlog: int) -> None:
    number, gate = board[NUMBER], Gate()
    subscription = number.subscribe(gate, backlog=backlog)
    number.add(Number(1))
    assert gate.entered.wait(PATIENCE_S)
    number.add(Number(2))
    closing = threading.Thread(target=subscription.close)
    closing.start()
    wait_for(lambda: not subscription.active)
    assert closing.is_alive()
    gate.open.set()
    closing.join(PATIENCE_S)
    number.add(Number(3))
    subscription.close()
    assert [sample.count for sample in gate.received] == [1]


@pytest.mark.parametrize("backlog", [1, 10])
def test_a_callback_may_close_its_own_subscription(board: Board, backlog: int) -> None:
    number, received = board[NUMBER], []
    errors: list[Exception] = []

    def once(sample: Sample[Number]) -> None:
        received.append(sample.count)
        subscription.close()

    subscription = number.subscribe(once, after=0, backlog=backlog, on_error=errors.append)
    number.add(Number(1))
    wait_for(lambda: not subscription.active)
    number.add(Number(2))
    subscription.close()
    assert (received, errors) == ([1], [])


@pytest.mark.parametrize("end", ["close", "remove"])
@pytest.mark.parametrize("backlog", [1, 10])
def test_it_ends_with_the_board(
    board: Board, end: str, backlog: int, caplog: pytest.LogCaptureFixture
) -> None:
    errors: list[Exception] = []
    subscription = board[NUMBER].subscribe(print, backlog=backlog, on_error=errors.append)
    assert subscription.active
    getattr(board, end)()
    wait_for(lambda: not subscription.active)
    subscription.close()
    assert errors == []
    assert caplog.records == []


@pytest.mark.parametrize(("backlog", "counts"), [(1, [1, 4]), (10, [1, 2, 3, 4])])
def test_a_finish_delivers_what_was_added_and_ends(
    board: Board, backlog: int, counts: list[int]
) -> None:
    number, gate = board[NUMBER], Gate()
    observed = Observed(number)
    subscription = Subscription(observed, gate, after=None, backlog=backlog, on_error=None)
    number.add(Number(1))
    assert gate.entered.wait(PATIENCE_S)
    for value in (2, 3, 4):
        number.add(Number(value))
        if backlog > 1:
            wait_for(lambda value=value: observed.after == value)
    subscription.finish()
    assert subscription.active
    gate.open.set()
    subscription.close()
    assert not subscription.active
    number.add(Number(5))
    assert [sample.count for sample in gate.received] == counts


def test_a_finish_with_nothing_new_just_ends(board: Board) -> None:
    with board[NUMBER].subscribe(print) as subscription:
        subscription.finish()
        wait_for(lambda: not subscription.active)


def test_what_a_closed_board_refuses_the_callback_is_no_error(board: Board) -> None:
    errors: list[Exception] = []
    number, gate = board[NUMBER], Gate()

    def answer(sample: Sample[Number]) -> None:
        gate(sample)
        number.add(Number())

    subscription = number.subscribe(answer, on_error=errors.append)
    number.add(Number())
    assert gate.entered.wait(PATIENCE_S)
    board.close()
    gate.open.set()
    subscription.close()
    assert errors == []


def test_a_closed_board_takes_no_subscription(board: Board) -> None:
    number = board[NUMBER]
    board.close()
    with pytest.raises(BoardClosedError):
        number.subscribe(print)


# ---- Errors ---------------------------------------------------------------------------------


@pytest.mark.parametrize("backlog", [1, 10])
def test_an_error_of_the_callback_is_reported_and_it_goes_on(
    board: Board, backlog: int, caplog: pytest.LogCaptureFixture
) -> None:
    number = board[NUMBER]
    errors: queue.SimpleQueue[Exception] = queue.SimpleQueue()

    def fail(sample: Sample[Number]) -> None:
        raise ArithmeticError(f"no {sample.message.value}")

    with number.subscribe(fail, backlog=backlog, on_error=errors.put):
        for value in (1, 2):
            number.add(Number(value))
            error = errors.get(timeout=PATIENCE_S)
            assert isinstance(error, ArithmeticError)
            assert str(error) == f"no {value}"
    printed = [record for record in caplog.records if record.levelno == logging.ERROR]
    assert len(printed) == 2
    assert "fail: ArithmeticError: no 1" in printed[0].getMessage()
    assert printed[0].exc_info is not None


def test_an_error_that_on_error_has_handled_is_not_logged(
    board: Board, caplog: pytest.LogCaptureFixture
) -> None:
    number = board[NUMBER]
    errors: queue.SimpleQueue[Exception] = queue.SimpleQueue()

    def fail(_: Sample[Number]) -> None:
        raise ArithmeticError

    def handle(error: Exception) -> bool:
        errors.put(error)
        return True

    with number.subscribe(fail, on_error=handle):
        number.add(Number(1))
        assert isinstance(errors.get(timeout=PATIENCE_S), ArithmeticError)
    assert caplog.records == []


def test_an_error_of_on_error_is_reported_too(
    board: Board, caplog: pytest.LogCaptureFixture
) -> None:
    number, received = board[NUMBER], []

    def fail(sample: object) -> None:
        received.append(sample)
        raise ArithmeticError

    with number.subscribe(fail, on_error=fail):
        for value in (1, 2):
            number.add(Number(value))
            wait_for(lambda value=value: len(received) == 2 * value)
    assert [r.getMessage() for r in caplog.records if "on_error failed" in r.getMessage()]


@pytest.mark.parametrize(
    ("arguments", "what"),
    [
        ({"after": -1}, "after=-1 must be the count of a message"),
        ({"backlog": 0}, "backlog=0 must be at least 1"),
    ],
)
def test_impossible_arguments(board: Board, arguments: dict[str, int], what: str) -> None:
    with pytest.raises(ValueError, match=what):
        board[NUMBER].subscribe(print, **arguments)  # type: ignore[arg-type]
