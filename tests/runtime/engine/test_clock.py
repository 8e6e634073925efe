"""Clocks: both kinds keep the same contract; the manual one moves only when told to."""

from __future__ import annotations

import time

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
