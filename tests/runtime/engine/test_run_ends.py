"""How runs end, in each schedule: a stop, a signal, the end of the board, an error in a machine."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from llfsm.runtime import (
    Arrangement,
    ExecutionError,
    Machine,
    ManualClock,
    Reason,
    State,
    TimeSlot,
    Timetable,
    Trace,
    define,
)
from llfsm.runtime.engine.events import Failed
from llfsm.whiteboard import Whiteboard
from waiting import rest_of

from .paced import Log, Stubborn, Waiting, worker


class NappingClock(ManualClock):
    """Do something at the n-th sleep."""

    def __init__(self, at: dict[int, Callable[[], object]]):
        super().__init__()
        self.at = at
        self.sleeps = 0

    def sleep_until_ns(self, deadline_ns: int) -> None:
        super().sleep_until_ns(deadline_ns)
        self.sleeps += 1
        self.at.get(self.sleeps, int)()


TEN_S = 10_000_000

SCHEDULES: dict[str, dict[str, Any]] = {
    "round robin": {"idle_us": TEN_S},
    "period": {"period_us": TEN_S},
    "timetable": {"timetable": Timetable([TimeSlot("M", us, 9) for us in (0, TEN_S)], 2 * TEN_S)},
}

in_each_schedule = pytest.mark.parametrize("schedule", SCHEDULES)


@in_each_schedule
@pytest.mark.parametrize("grace_s", [0, 0.5, 1])
def test_a_stop_ends_a_run_within_the_grace_period(schedule: str, grace_s: float):
    clock = NappingClock({100: lambda: arrangement.stop("enough")})  # in a sleep, after 2 s
    arrangement = Arrangement(clock=clock, **SCHEDULES[schedule])
    arrangement.load(Stubborn, name="M")
    assert arrangement.run(grace_s=grace_s) is Reason.STOPPED
    assert arrangement.stop_cause == "enough"
    assert 2 + grace_s <= clock.now_ns() / 1e9 <= 2 + grace_s + 0.02


@in_each_schedule
def test_a_machine_that_has_a_turn_in_the_grace_period_may_accept(schedule: str):
    clock = NappingClock({100: lambda: arrangement.stop()})
    arrangement = Arrangement(clock=clock, **SCHEDULES[schedule])
    arrangement.load(Waiting, name="M")
    assert arrangement.run(grace_s=30) is Reason.ACCEPTING
    assert clock.now_ns() / 1e9 <= 2 + 30


@pytest.mark.parametrize("schedule", ["period", "timetable"])
def test_a_stop_keeps_the_grid(schedule: str):
    clock, log = NappingClock({100: lambda: arrangement.stop()}), Log()
    arrangement = Arrangement(clock=clock, **SCHEDULES[schedule])
    arrangement.load(worker("M", clock, log))
    assert arrangement.run(grace_s=25) is Reason.STOPPED
    assert [us for _, us in log] == [0, TEN_S, 2 * TEN_S]


@in_each_schedule
def test_sigterm_ends_a_process_within_the_grace_period(schedule: str):
    options = {
        "round robin": "idle_us=3_000_000_000",
        "period": "period_us=3_000_000_000",
        "timetable": "timetable=Timetable([TimeSlot('S', 0, 1)], 3_000_000_000)",
    }
    program = (
        "from llfsm.runtime import *\n"
        "class S(Machine):\n"
        "    a = State(); b = State()\n"
        "    a.to(b, when=lambda m: False)\n"
        "    a.internal(lambda m: print('ready', flush=True))\n"
        f"arrangement = Arrangement([S], {options[schedule]})\n"
        "print(arrangement.run(grace_s=0.05), arrangement.stop_cause)\n"
    )
    with subprocess.Popen(
        [sys.executable, "-c", program], stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        try:
            assert process.stdout.readline() == "ready\n"
            process.send_signal(signal.SIGTERM)
            printed = rest_of(process)  # the next turn would be in fifty minutes
        finally:
            process.kill()
    assert printed.splitlines()[-1] == "stopped SIGTERM"
    assert process.returncode == 0


@in_each_schedule
def test_the_end_of_the_board_ends_a_run(schedule: str, tmp_path: Path):
    with Whiteboard("board", directory=tmp_path) as board:
        clock = NappingClock({100: board.path.unlink})
        arrangement = Arrangement(clock=clock, whiteboard=board, **SCHEDULES[schedule])
        arrangement.load(Stubborn, name="M")
        assert arrangement.run(grace_s=0.5, max_rounds=10) is Reason.STOPPED
    assert arrangement.stop_cause == "the whiteboard was closed or removed"
    assert clock.now_ns() / 1e9 < 3


@pytest.mark.parametrize("schedule", ["period", "timetable"])
def test_a_run_that_is_always_late_notices_the_end_of_the_board(schedule: str, tmp_path: Path):
    clock, log = ManualClock(), Log()
    with Whiteboard("board", directory=tmp_path) as board:
        timetable = Timetable([TimeSlot("M", 0, 9)], 1_000)
        period = {"period_us": 1_000} if schedule == "period" else {"timetable": timetable}
        machines = [worker("M", clock, log, [1_500] * 2_000)]
        arrangement = Arrangement(machines, clock=clock, whiteboard=board, **period)
        board.path.unlink()
        arrangement.run(grace_s=0.1, max_rounds=1_000)
    assert arrangement.stop_cause == "the whiteboard was closed or removed"


def test_after_an_end_in_mid_cycle_nobody_has_a_turn_any_more():
    clock, log = ManualClock(), Log()
    timetable = Timetable([TimeSlot("A", 0, 9), TimeSlot("B", TEN_S, 9)], 2 * TEN_S)
    machines = [worker("A", clock, log), worker("B", clock, log)]
    arrangement = Arrangement(machines, clock=clock, timetable=timetable)
    arrangement.attach(lambda event: log == [("A", 0)] and arrangement.end())
    assert arrangement.run() is Reason.CLOSED
    assert (log, clock.now_ns()) == ([("A", 0)], 0)


def failing(name: str) -> type[Machine]:
    """Return a machine whose code raises in its second turn, and if it is asked to go on."""
    work, never = State("WORK"), State("NEVER")

    def fail(machine: Any) -> None:
        machine.turns += 1
        if machine.turns > 1:
            raise ValueError("bang")

    work.internal(fail)
    work.to(never, when=lambda machine: False)
    return define(name, [work, never], variables={"turns": (int, 0)})


SHORT: dict[str, dict[str, Any]] = {
    "round robin": {"idle_us": 1_000},
    "period": {"period_us": 1_000},
    "timetable": {"timetable": Timetable([TimeSlot("F", 0, 9), TimeSlot("W", 0, 9)], 1_000)},
}


@in_each_schedule
def test_an_error_in_a_machine_stops_everything(schedule: str):
    clock, log = ManualClock(), Log()
    machines = [failing("F"), worker("W", clock, log)]
    arrangement = Arrangement(machines, clock=clock, **SHORT[schedule])
    with pytest.raises(ExecutionError, match="machine F, state WORK, Internal: ValueError: bang"):
        arrangement.run()
    assert arrangement.reason is Reason.FAILED
    assert [us for _, us in log] == [0]


@in_each_schedule
def test_an_error_in_a_machine_suspends_it_alone(schedule: str, caplog: pytest.LogCaptureFixture):
    clock, log, trace = ManualClock(), Log(), Trace()
    machines = [failing("F"), worker("W", clock, log)]
    arrangement = Arrangement(
        machines,
        clock=clock,
        timed=True,
        on_error="suspend",
        observers=[trace],
        **SHORT[schedule],
    )
    assert arrangement.run(max_rounds=4) is Reason.MAX_ROUNDS
    assert arrangement.is_suspended("F")
    assert [us for _, us in log] == [0, 1_000, 2_000, 3_000]
    assert [(event.round, event.machine) for event in trace if isinstance(event, Failed)] == [
        (2, "F")
    ]
    assert len(caplog.records) == 1
    ringlets = {of.machine: of.ringlets for of in arrangement.statistics()}
    assert ringlets == {"F": 4, "W": 4}  # the failing turn and the suspended ones count


@pytest.mark.parametrize("grace_s", [0, 0.01])
def test_machines_see_a_stop_in_a_turn_though_the_period_is_longer_than_the_grace(grace_s: float):
    clock = ManualClock()
    seen: list[tuple[float, bool]] = []

    class Asked(Machine):
        on, off = State(), State()

        @on.internal
        def _(self) -> None:
            seen.append((clock.now_ns() / 1e9, self.stopping))
            if len(seen) == 2:
                arrangement.stop()

        on.to(off, when=lambda self: self.stopping)

    arrangement = Arrangement([Asked], clock=clock, period_us=60_000_000, grace_s=grace_s)
    assert arrangement.run() is Reason.STOPPED or arrangement.reason is Reason.ACCEPTING
    assert [stopping for _, stopping in seen] == [False, False]
    assert arrangement.rounds >= 3
    assert clock.now_ns() / 1e9 <= 60 + 0.05
