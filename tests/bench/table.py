"""A row of the benchmark: how it is judged, and how it reads as text and as JSON."""

from __future__ import annotations

from collections.abc import Callable
from operator import truediv
from statistics import median
from typing import Any, NamedTuple

from measure import Side

__all__ = [
    "ADDED_MS",
    "ADDED_NS",
    "ALONE_MIB",
    "ALONE_MS",
    "ALONE_S",
    "BESIDE",
    "BYTES",
    "FASTER",
    "FRAMES",
    "HEAD",
    "LEAST",
    "MEDIANS",
    "MORE_BYTES",
    "MORE_PERCENT",
    "P99S",
    "PERCENT",
    "PERIODS",
    "RATE",
    "SLOWER",
    "WORST_S",
    "Row",
    "Score",
]


def _p99(samples: list[float]) -> float:
    return sorted(samples)[len(samples) * 99 // 100]


class Score(NamedTuple):
    """What a row is judged by: a number made of all samples of ours, and of the peer's."""

    of: Callable[..., float]
    unit: str
    more_is_better: bool = False
    sampled: str = "ns"  # the unit of the samples
    shown: Callable[[list[float]], float] = median


# A ratio is the median over the pairs. A whole process is too long for its neighbour to suffer
# the same, and others only ever add to its time: what it costs itself is the minimum.
FASTER = Score(lambda ours, its: median(map(truediv, its, ours)), "x", more_is_better=True)
SLOWER = Score(lambda ours, its: median(map(truediv, ours, its)), "x")
MEDIANS = Score(lambda ours, its: median(ours) / median(its), "x")
LEAST = Score(lambda ours, its: min(ours) / min(its), "x", shown=min)
P99S = Score(lambda ours, its: _p99(ours) / _p99(its), "x", shown=_p99)
ADDED_NS = Score(lambda ours, its: min(ours) - min(its), " ns", shown=min)
ADDED_MS = Score(lambda ours, its: (min(ours) - min(its)) / 1e6, " ms", shown=min)
ALONE_MS = Score(lambda ours: min(ours) / 1e6, " ms", shown=min)
ALONE_S = Score(lambda ours: min(ours) / 1e9, " s", shown=min)
WORST_S = Score(lambda ours: max(ours) / 1e9, " s", shown=max)
ALONE_MIB = Score(lambda ours: median(ours) / 2**20, " MiB", sampled="bytes")
MORE_BYTES = Score(lambda ours, its: ours[0] / its[0], "x", sampled="B")
MORE_PERCENT = Score(lambda ours, its: ours[0] / its[0], "x", sampled="%")
BYTES = Score(median, " B", sampled="B")
RATE = Score(max, "/s", more_is_better=True, sampled="/s", shown=max)
PERCENT = Score(max, " %", sampled="%")
BESIDE = Score(lambda ours, its: max(ours), " %", sampled="%")  # what it is, is shown beside
FRAMES = Score(min, "/s", more_is_better=True, sampled="/s")
PERIODS = Score(max, " periods", sampled="periods")

_LINE = "{:<33}{:>9} {:>9}  {:<20}{:>9}  {:<10} {}"
HEAD = _LINE.format("", "ours", "theirs", "of", "result", "promised", "met")


class Row(NamedTuple):
    """What was measured side by side, ours first; a second side is what it is compared with."""

    what: str
    sides: list[Side]
    score: Score
    promised: float | None
    unmeasured: str | None = None  # why there are no samples of ours, if there are none

    @property
    def value(self) -> float | None:
        """What is judged, or None if one of the sides was not measured."""
        samples = [side.samples for side in self.sides]
        return self.score.of(*samples) if all(samples) else None

    @property
    def met(self) -> bool | None:
        """Whether the promise is met; None if there is none, or nothing to judge."""
        if self.promised is None or self.value is None:
            return None
        if self.score.more_is_better:
            return self.value >= self.promised
        return self.value <= self.promised

    def text(self) -> str:
        """Return the row as a line below `HEAD`."""
        shown = [_readable(side, self.score) for side in self.sides]
        sign = ">=" if self.score.more_is_better else "<="
        return _LINE.format(
            self.what,
            *(shown if len(shown) == 2 else [*shown, ""]),
            self.sides[1].who if len(shown) == 2 else "",
            "" if self.value is None else f"{self.value:.3g}{self.score.unit}",
            "" if self.promised is None else f"{sign} {self.promised:g}{self.score.unit}",
            {True: "yes", False: "NO", None: ""}[self.met],
        ).rstrip()

    def json(self) -> dict[str, Any]:
        """Return the row as JSON has it: `sides` are ours and, where there is one, the peer's."""
        return {
            "what": self.what,
            "sides": [
                {
                    "who": who,
                    "call": call,
                    "unit": self.score.sampled,
                    "minimum": min(samples, default=None),
                    "median": median(samples) if samples else None,
                }
                for who, call, samples in self.sides
            ],
            "value": self.value,
            "unit": self.score.unit.strip(),
            "promised": self.promised,
            "more_is_better": self.score.more_is_better,
            "met": self.met,
            "unmeasured": self.unmeasured,
        }


def _readable(side: Side, score: Score) -> str:
    if not side.samples:
        return "missing"
    value = score.shown(side.samples)
    if score.sampled == "bytes":
        return f"{value / 2**20:.1f} MiB"
    if score.sampled in ("%", "periods", "/s", "B"):
        return f"{value:.3g} {score.sampled}"
    if value >= 1e6:
        return f"{value / 1e6:.1f} ms"
    return f"{value:.1f} ns" if value < 100 else f"{value:.0f} ns"
