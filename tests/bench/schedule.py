"""Run ten machines at 1 kHz, each in its own slot of a timetable; print how well times were kept.

Or, to compare with, an empty loop that sleeps from one millisecond to the next. The output is
JSON: nanoseconds of jitter (the time between two turns less the planned one), the drift in
periods at the end, the turns and how many were late.

Or run them with a period for so many rounds whenever a line comes. Print by how many nanoseconds
each round began late, and for how many the thread had waited for a processor by then; to compare
with, sleep.c does the same.
"""

import json
import os
import sys
import time
from itertools import pairwise

from llfsm.runtime import Arrangement, Machine, RealtimeError, Requirement, State, Timetable
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


class Watched(Worker):
    """Note of each round by how much it was late, as the arrangement itself times it."""

    schedstat: int
    seen: list[int]

    @Worker.work.internal
    def _(self) -> None:
        self.turns += 1
        watch = self._seat.kernel.stopwatch
        waited = os.pread(self.schedstat, 64, 0).split()[1]
        self.seen += (watch.begin_ns - watch.due_ns, int(waited))


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
    reported = arrangement.statistics()
    planned_ns = (rounds - 1) * PERIOD_US * 1000
    first = workers[0]
    return {
        "p50": max(machine.jitter_us.p50 for machine in reported) * 1e3,
        "p99": max(machine.jitter_us.p99 for machine in reported) * 1e3,
        "drift": abs(first.last_ns - first.first_ns - planned_ns) / (PERIOD_US * 1000),
        "turns": sum(machine.ringlets for machine in reported),
        "late": sum(machine.overruns for machine in reported),
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


def lateness(rounds: int, board: str, realtime: int | None) -> None:
    """Run the machines with a period for so many rounds, for each line of the input."""
    schedstat = os.open("/proc/thread-self/schedstat", os.O_RDONLY)
    with Whiteboard(board) as whiteboard:
        try:
            for _ in sys.stdin:
                first = Watched(wanted=rounds, schedstat=schedstat, seen=[])
                machines = [first, *(Worker(wanted=rounds) for _ in range(MACHINES - 1))]
                arrangement = Arrangement(
                    machines, whiteboard=whiteboard, period_us=PERIOD_US, realtime=realtime
                )
                try:
                    arrangement.run()
                except RealtimeError:
                    print("refused", flush=True)
                    return
                print(*first.seen, flush=True)
        finally:
            whiteboard.remove()


if __name__ == "__main__" and sys.argv[1] == "lateness":
    lateness(int(sys.argv[2]), sys.argv[3], int(sys.argv[4]) or None)
elif __name__ == "__main__":
    what, seconds, board = sys.argv[1], float(sys.argv[2]), sys.argv[3]
    figures = machines(seconds, board) if what == "machines" else loop(seconds)
    print(json.dumps(figures))
