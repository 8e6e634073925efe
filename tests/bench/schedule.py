"""Run ten machines at 1 kHz, each in its own slot of a timetable; print how well times were kept.

Or, to compare with, an empty loop that sleeps from one millisecond to the next. The output is
JSON: nanoseconds of jitter (the time between two turns less the planned one), the drift in
periods at the end, the turns and how many were late.
"""

import json
import sys
import time
from itertools import pairwise

from llfsm.runtime import Arrangement, Machine, Requirement, State, Timetable
from llfsm.whiteboard import Whiteboard

PERIOD_US = 1000
MACHINES = 10


class Worker(Machine):
    """Count its turns for so many of them, and remember when the first and the last was."""

    turns: int = 0
    wanted: int = 1
    first_ns: int = 0
    last_ns: int = 0

    work = State()
    done = State()

    @work.internal
    def _(self) -> None:
        self.last_ns = time.monotonic_ns()
        self.first_ns = self.first_ns or self.last_ns
        self.turns += 1

    @work.to(done)
    def all_done(self) -> bool:
        return self.turns >= self.wanted


def machines(seconds: float, board: str) -> dict[str, float]:
    """Run the machines for so long on a whiteboard."""
    rounds = round(seconds * 1e6 / PERIOD_US)
    names = [f"worker{number}" for number in range(MACHINES)]
    starts = range(0, PERIOD_US, PERIOD_US // MACHINES)
    table = Timetable.meeting(
        Requirement(name, PERIOD_US, PERIOD_US // MACHINES, (start,))
        for name, start in zip(names, starts, strict=True)
    )
    with Whiteboard(board) as whiteboard:
        arrangement = Arrangement(whiteboard=whiteboard, timetable=table)
        workers = [Worker(wanted=rounds) for _ in names]
        for name, worker in zip(names, workers, strict=True):
            arrangement.load(worker, name=name)
        try:
            arrangement.run()
        finally:
            whiteboard.remove()
    told = arrangement.statistics()
    planned_ns = (rounds - 1) * PERIOD_US * 1000
    first = workers[0]
    return {
        "p50": max(machine.jitter_us.p50 for machine in told) * 1e3,
        "p99": max(machine.jitter_us.p99 for machine in told) * 1e3,
        "drift": abs(first.last_ns - first.first_ns - planned_ns) / (PERIOD_US * 1000),
        "turns": sum(machine.ringlets for machine in told),
        "late": sum(machine.overruns for machine in told),
    }


def loop(seconds: float) -> dict[str, float]:
    """Sleep from one millisecond to the next for so long."""
    rounds = round(seconds * 1e6 / PERIOD_US)
    begin_ns = time.monotonic_ns()
    times = []
    for number in range(rounds):
        left_ns = begin_ns + number * PERIOD_US * 1000 - time.monotonic_ns()
        if left_ns > 0:
            time.sleep(left_ns / 1e9)
        times.append(time.monotonic_ns())
    steps = sorted(abs(after - before - PERIOD_US * 1000) for before, after in pairwise(times))
    return {"p50": steps[len(steps) // 2], "p99": steps[len(steps) * 99 // 100]}


if __name__ == "__main__":
    what, seconds, board = sys.argv[1], float(sys.argv[2]), sys.argv[3]
    figures = machines(seconds, board) if what == "machines" else loop(seconds)
    print(json.dumps(figures))
