"""Histograms of durations, of fixed size, and how durations are spread."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple, Self

if TYPE_CHECKING:
    from llfsm.runtime.engine import twin


_RANGES = 640  # those up to two hours


class Histogram:
    """Count durations in ranges that are a sixteenth to a thirty-second of them wide.

    Those below 32 ns have a range each; a negative one counts as 0. Its size is fixed, however long
    it counts. `counts` are the numbers of durations in each range, the last of which has no upper
    end, `total` is their sum, and `longest_ns` the greatest duration.
    """

    __slots__ = ("counts", "longest_ns", "total")

    def __init__(self) -> None:
        self.counts = [0] * _RANGES
        self.total = 0
        self.longest_ns = 0

    def add(self, ns: int, /) -> None:
        """Count a duration."""
        ns = max(ns, 0)
        shift = max(ns.bit_length() - 5, 0)  # of ns >> shift the sixteens bit is set
        self.counts[min((shift << 4) + (ns >> shift), _RANGES - 1)] += 1
        self.total += 1
        self.longest_ns = max(self.longest_ns, ns)


class Spread(NamedTuple):
    """Half of the values are at most `p50`, 99 in 100 at most `p99`, all at most `max`.

    Microseconds; the first two are right to a thirty-second (3 %), below 32 ns exactly.
    """

    p50: float
    p99: float
    max: float

    @classmethod
    def of(cls, histogram: twin.Histogram) -> Self | None:
        """Return how durations are spread: quantiles are middles of ranges. None without any."""
        if not histogram.total:
            return None
        p50, p99 = (_quantile(histogram, part) for part in (0.5, 0.99))
        return cls(p50, p99, histogram.longest_ns / 1e3)


def doublings(histogram: twin.Histogram) -> tuple[int, ...]:
    """Return how many were shorter than 1 us, how many others than 2 us, 4 us and so on."""
    found: list[int] = []
    for number, count in enumerate(histogram.counts):
        if count:
            place = (int(_middle_ns(number)) // 1000).bit_length()
            found += [0] * (place + 1 - len(found))
            found[place] += count
    return tuple(found)


def _quantile(histogram: twin.Histogram, part: float) -> float:
    left = part * histogram.total
    number = -1
    counts = histogram.counts
    while left > 0:
        number += 1
        left -= counts[number]
    return min(_middle_ns(number), histogram.longest_ns) / 1e3


def _middle_ns(number: int) -> float:
    shift = max((number >> 4) - 1, 0)  # which power of two is the width of the range
    return (number - (shift << 4) + 0.5) * 2**shift if shift else number
