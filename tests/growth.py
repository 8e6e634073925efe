"""Measure what code keeps in memory. Importable from every test: `from growth import growth_of`."""

from __future__ import annotations

import gc
import tracemalloc
from collections.abc import Callable

import llfsm

__all__ = ["growth_of"]


def growth_of(use: Callable[[], object]) -> int:
    """Return the bytes that llfsm's code keeps of what it allocates in `use()`.

    Call `use` once before, so that what is made once is there. Other libraries and threads of the
    test's process do not count.
    """
    ours = [tracemalloc.Filter(True, f"{path}/*") for path in llfsm.__path__]
    tracemalloc.start()
    try:
        use()
        gc.collect()
        kept = tracemalloc.take_snapshot().filter_traces(ours)
        return sum(trace.size for trace in kept.traces)
    finally:
        tracemalloc.stop()
