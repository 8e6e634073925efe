"""Quantiles of durations, from a histogram of fixed size."""

from __future__ import annotations

from collections.abc import Iterable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from llfsm.runtime.engine.histogram import Histogram, Spread, range_of

from .quantiles import TOLERANCE, exact


def spread_of(durations_ns: Iterable[int]) -> Spread:
    histogram = Histogram()
    for ns in durations_ns:
        histogram.add(ns)
    spread = histogram.spread()
    assert spread is not None
    return spread


durations = st.integers(0, 70) | st.integers(0, 10**10) | st.sampled_from([2**n for n in range(40)])


@given(st.lists(durations, min_size=1, max_size=300))
def test_quantiles_are_right_within_the_width_of_a_range(costs_ns: list[int]):
    spread = spread_of(costs_ns)
    assert spread.max == max(costs_ns) / 1e3
    assert spread.p50 == pytest.approx(exact(50, costs_ns), rel=TOLERANCE)
    assert spread.p99 == pytest.approx(exact(99, costs_ns), rel=TOLERANCE)
    assert spread.p50 <= spread.p99 <= spread.max


def test_short_costs_are_exact():
    assert spread_of(range(32)) == (0.015, 0.031, 0.031)


def test_one_slow_turn_in_a_hundred_is_in_the_maximum_only():
    costs_ns = [7] * 99 + [10**9]
    assert spread_of(costs_ns) == (0.007, 0.007, 1e6)
    assert spread_of([*costs_ns, 10**9]) == (0.007, pytest.approx(1e6, rel=TOLERANCE), 1e6)


def test_there_is_no_spread_of_nothing():
    assert Histogram().spread() is None


@given(st.integers(0, 2**43 - 1))
def test_looking_a_range_up_finds_what_is_computed(ns: int):
    """Ranges follow each other without a gap, and each is at most a sixteenth wide."""
    number = range_of(ns)
    assert range_of(ns + 1) - number in (0, 1)
    shift = max(ns.bit_length() - 5, 0)
    assert number == (shift << 4) + (ns >> shift)


def test_hours_count_as_the_longest_of_all():
    day_ns = 24 * 3_600 * 10**9
    spread = spread_of([day_ns, 400 * day_ns])
    assert spread.p50 <= spread.max == 400 * day_ns / 1e3
