"""Histograms of durations, of fixed size, and how durations are spread."""

from __future__ import annotations

from typing import NamedTuple

__all__ = ["NEAR", "Histogram", "Spread", "range_of"]


class Spread(NamedTuple):
    """Half of the values are at most `p50`, 99 in 100 at most `p99`, all at most `max`.

    Microseconds; the first two are right to a thirty-second (3 %), below 32 ns exactly.
    """

    p50: float
    p99: float
    max: float


class Histogram:
    """Count durations in ranges that are a sixteenth to a thirty-second of them wide.

    Those below 32 ns have a range each. Quantiles are the middles of ranges, so they are right to
    a thirty-second. Its size is fixed, however long it counts.
    """

    __slots__ = ("counts", "longest_ns")

    def __init__(self) -> None:
        self.counts = [0] * _RANGES
        self.longest_ns = 0

    def add(self, ns: int) -> None:
        """Count a duration, which is 0 or more."""
        self.counts[range_of(ns)] += 1
        self.longest_ns = max(self.longest_ns, ns)

    @property
    def total(self) -> int:
        """The number of durations."""
        return sum(self.counts)

    def spread(self) -> Spread | None:
        """Return how they are spread; None before the first."""
        if not self.total:
            return None
        return Spread(self._quantile(0.5), self._quantile(0.99), self.longest_ns / 1e3)

    def doublings(self) -> tuple[int, ...]:
        """Return how many were shorter than 1 us, how many others than 2 us, 4 us and so on."""
        found: list[int] = []
        for number, count in enumerate(self.counts):
            if count:
                place = (int(_middle_ns(number)) // 1000).bit_length()
                found += [0] * (place + 1 - len(found))
                found[place] += count
        return tuple(found)

    def _quantile(self, part: float) -> float:
        left = part * self.total
        number = -1
        while left > 0:
            number += 1
            left -= self.counts[number]
        return min(_middle_ns(number), self.longest_ns) / 1e3


def _shift_of(number: int) -> int:
    """Return which power of two is the width of a range."""
    return max((number >> 4) - 1, 0)


def _middle_ns(number: int) -> float:
    shift = _shift_of(number)
    return (number - (shift << 4) + 0.5) * 2**shift if shift else number


def range_of(ns: int) -> int:
    """Return the number of a duration's range; the last one has no upper end."""
    if ns < len(NEAR):
        return NEAR[ns]
    shift = ns.bit_length() - 5  # of ns >> shift the sixteens bit is set
    return min((shift << 4) + (ns >> shift), _RANGES - 1)


def _numbers(longest_ns: int) -> list[int]:
    """Return the numbers of the ranges of all durations below the longest, to look them up."""
    numbers: list[int] = []
    while len(numbers) < longest_ns:
        number = numbers[-1] + 1 if numbers else 0
        numbers += [number] * (1 << _shift_of(number))
    return numbers


_RANGES = 640  # those up to two hours
NEAR = _numbers(1 << 13)
