"""Quantiles of durations, from a histogram of fixed size."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from definition import BUILT
from llfsm.runtime.engine.statistics import DefinedHistogram, Histogram, Spread, doublings

from .quantiles import TOLERANCE, exact


def filled(durations_ns: Iterable[int], kind: Any = Histogram) -> Any:
    filled = kind()
    for ns in durations_ns:
        filled.add(ns)
    return filled


def spread_of(durations_ns: Iterable[int]) -> Spread:
    spread = Spread.of(filled(durations_ns))
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
    assert Spread.of(Histogram()) is None


def range_of(ns: int) -> int:
    return filled([ns]).counts.index(1)


@given(st.integers(0, 2**42))
def test_ranges_follow_each_other_and_are_at_most_a_sixteenth_wide(ns: int):
    assert range_of(ns + 1) - range_of(ns) in (0, 1)
    assert range_of(ns + ns // 16 + 1) > range_of(ns)


@pytest.mark.skipif(not BUILT, reason="the twins in C are not built, or hidden")
@given(st.lists(durations | st.integers(-(2**63), 2**63 - 1), max_size=100))
def test_the_twin_counts_what_the_definition_counts(durations_ns: list[int]):
    twin_, defined = filled(durations_ns), filled(durations_ns, DefinedHistogram)
    assert twin_.counts == defined.counts
    assert (twin_.total, twin_.longest_ns) == (defined.total, defined.longest_ns)
    assert Spread.of(twin_) == Spread.of(defined)
    assert doublings(twin_) == doublings(defined)


def test_hours_count_as_the_longest_of_all():
    day_ns = 24 * 3_600 * 10**9
    spread = spread_of([day_ns, 400 * day_ns])
    assert spread.p50 <= spread.max == 400 * day_ns / 1e3
