"""The pace of the simulation: 62.5 steps a second."""

import time
from collections.abc import Callable

__all__ = ["STEP_NS", "run"]

STEP_NS = 16_000_000


def run(step: Callable[[], None], is_over: Callable[[], bool]) -> None:
    """Step every 16 ms until `is_over`. A step that is late is not made up for, as in turtlesim."""
    due = time.monotonic_ns()
    while not is_over():
        step()
        due = max(due + STEP_NS, time.monotonic_ns())
        time.sleep(max(0, due - time.monotonic_ns()) / 1e9)
