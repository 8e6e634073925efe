"""What quantiles are, exactly, and how near to them those of a histogram must be."""

from __future__ import annotations

import math

TOLERANCE = 1 / 32 + 1e-9  # half of a range that is at most a sixteenth of its values


def exact(part: int, values: list[int]) -> float:
    """Return the smallest value such that `part` in 100 are not greater; from ns to us."""
    return sorted(values)[math.ceil(part * len(values) / 100) - 1] / 1e3
