"""When the simulator steps."""

from __future__ import annotations

from llfsm.bridges.turtlesim.simulator import run
from llfsm.runtime import ManualClock


def test_a_late_step_is_not_made_up_for():
    clock, stepped_ms = ManualClock(), []

    def step():
        stepped_ms.append(clock.now_ns() / 1e6)
        clock.advance(ms=100 if len(stepped_ms) == 3 else 5)  # what the step takes

    run(step, lambda: len(stepped_ms) == 6, clock)
    assert stepped_ms == [0, 16, 32, 132, 148, 164]


def test_what_is_over_from_the_beginning_never_steps():
    run(lambda: 1 / 0, lambda: True, ManualClock())
