"""Measure what code keeps in memory. Importable from every test: `from growth import growth_of`."""

from __future__ import annotations

import gc
import sys
from collections.abc import Callable

__all__ = ["growth_of"]

_ROUNDS = 3


def growth_of(use: Callable[[], object]) -> int:
    """Return how many blocks of memory `use()` leaves allocated: at least one for each object.

    It is the least of several calls, as other threads of the process allocate, too. Those of
    Zenoh are why this is not `tracemalloc`: Python 3.11 crashes when a thread gets to it for the
    first time while that starts or stops.
    """
    return min(_growth_of_one(use) for _ in range(_ROUNDS))


def _growth_of_one(use: Callable[[], object]) -> int:
    gc.collect()
    before = sys.getallocatedblocks()
    use()
    gc.collect()
    return sys.getallocatedblocks() - before
