"""Clocks: both kinds keep the same contract; the manual one moves only when told to."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager

import pytest

from llfsm.runtime import Clock, ClockError, ManualClock, MonotonicClock


@pytest.fixture(params=[ManualClock, MonotonicClock])
def clock(request: pytest.FixtureRequest) -> Clock:
    return request.param()


def test_sleeping_ends_at_the_deadline_or_later(clock: Clock):
    deadline = clock.now_ns() + 2_000_000
    clock.sleep_until_ns(deadline)
    assert clock.now_ns() >= deadline


def test_a_deadline_that_has_passed_does_not_turn_time_back(clock: Clock):
    before = clock.now_ns()
    clock.sleep_until_ns(before - 10**9)
    assert clock.now_ns() >= before


def test_the_monotonic_clock_is_the_hosts():
    before = time.monotonic_ns()
    assert before <= MonotonicClock().now_ns() <= time.monotonic_ns()


@pytest.fixture
def signals() -> Iterator[Callable[[Callable[..., None]], AbstractContextManager[None]]]:
    """Return what lets a handler have a signal every millisecond while its block runs."""
    before = signal.getsignal(signal.SIGUSR1)

    @contextmanager
    def sent(handler: Callable[..., None]) -> Iterator[None]:
        signal.signal(signal.SIGUSR1, handler)
        over = threading.Event()

        def send() -> None:
            while not over.wait(0.001):
                os.kill(os.getpid(), signal.SIGUSR1)

        sender = threading.Thread(target=send)
        sender.start()
        try:
            yield
        finally:
            over.set()
            signal.signal(signal.SIGUSR1, signal.SIG_IGN)
            sender.join()

    yield sent
    signal.signal(signal.SIGUSR1, before)


def test_a_sleep_goes_on_after_a_signal(signals: Callable[..., AbstractContextManager[None]]):
    clock, handled = MonotonicClock(), []
    with signals(lambda number, _: handled.append(number)):
        while not handled:
            deadline = clock.now_ns() + 20_000_000
            clock.sleep_until_ns(deadline)
            assert clock.now_ns() >= deadline


def test_a_handler_that_raises_ends_a_sleep(
    signals: Callable[..., AbstractContextManager[None]],
):
    ready: list[bool] = []

    def fail(*_: object) -> None:
        if ready:
            signal.signal(signal.SIGUSR1, signal.SIG_IGN)
            raise ZeroDivisionError

    clock = MonotonicClock()
    far = clock.now_ns() + 3600 * 10**9

    def sleep() -> None:
        ready.append(True)
        clock.sleep_until_ns(far)

    with signals(fail), pytest.raises(ZeroDivisionError):
        sleep()
    assert clock.now_ns() < far


def test_a_time_that_is_none_is_refused():
    with pytest.raises(TypeError):
        MonotonicClock().sleep_until_ns("soon")  # type: ignore[arg-type]


def test_a_manual_clock_moves_when_told_to():
    clock = ManualClock(start_ns=7)
    assert [clock.now_ns(), clock.now_ns()] == [7, 7]
    clock.advance(s=1, ms=2, us=3, ns=4)
    assert clock.now_ns() == 1_002_003_011


def test_a_manual_clock_does_not_go_back():
    clock = ManualClock()
    with pytest.raises(ClockError, match="cannot go back by 1000 ns"):
        clock.advance(us=-1)
    assert isinstance(ClockError(), ValueError)
