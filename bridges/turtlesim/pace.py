"""The pace of the simulation: 62.5 steps a second."""

from __future__ import annotations

from collections.abc import Callable

from llfsm.runtime.engine.clock import Clock, MonotonicClock

__all__ = ["STEP_NS", "run"]

STEP_NS = 16_000_000


def run(step: Callable[[], None], is_over: Callable[[], bool], clock: Clock | None = None) -> None:
    """Step every 16 ms until `is_over`. A step that is late is not made up for, as in turtlesim."""
    clock = clock or MonotonicClock()
    due = clock.now_ns()
    while not is_over():
        step()
        due = max(due + STEP_NS, clock.now_ns())
        clock.sleep_until_ns(due)
