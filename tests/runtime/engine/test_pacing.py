"""A fixed period and a timetable: when turns begin, which are late, and how such runs end."""

from __future__ import annotations

import logging
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from llfsm.runtime import (
    Arrangement,
    ExecutionError,
    LoadError,
    Machine,
    ManualClock,
    OptionError,
    Reason,
    Requirement,
    State,
    TimeSlot,
    Timetable,
    Trace,
    define,
)
from llfsm.runtime.engine.events import Failed, IdleSleep
from llfsm.runtime.engine.pacing import Pacer
from llfsm.runtime.testing import NotReachedError, run_until
from llfsm.whiteboard import Whiteboard
from llfsm.whiteboard.local import LocalBoard

Log = list[tuple[str, int]]
"""Which machine began a turn, and when in microseconds."""


def worker(name: str, clock: ManualClock, log: Log, costs_us: list[int] | None = None) -> Any:
    """Return a machine for ever at work: its n-th turn takes costs_us[n], later ones nothing."""
    costs = iter(costs_us or [])
    work, never = State("WORK"), State("NEVER")

    def turn(machine: Machine) -> None:
        log.append((name, clock.now_ns() // 1_000))
        clock.advance(us=next(costs, 0))

    work.internal(turn)
    work.to(never, when=lambda machine: False)
    return define(name, [work, never])


class Waiting(Machine):
    """Accept when asked to stop."""

    waiting = State()
    done = State()
    waiting.to(done, when=lambda m: m.stopping)


class Stubborn(Machine):
    a = State()
    b = State()
    a.to(b, when=lambda m: False)


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


# When turns begin

PERIOD_US = 1_000
costs = st.lists(st.sampled_from([0, 1, 300, 999, 1_000, 1_001, 1_700, 5_000]), max_size=12)


def planned(begin_us: int, slots: Iterator[int], costs_us: list[int]) -> list[int]:
    """Return when turns begin: at their slot's time, or at once if the one before ended later."""
    begins, free_us = [], 0
    for slot_us, cost_us in zip(slots, costs_us, strict=False):
        begins.append(max(begin_us + slot_us, free_us))
        free_us = begins[-1] + cost_us
    return begins


@given(costs, costs, st.integers(0, 10**9))
def test_the_nth_round_begins_n_periods_after_the_first(
    first: list[int], second: list[int], start_us: int
):
    clock, log = ManualClock(start_us * 1_000), Log()
    machines = [worker("A", clock, log, first), worker("B", clock, log, second)]
    Arrangement(machines, clock=clock, period_us=PERIOD_US).run(max_rounds=15)
    first, second = (turns + [0] * (15 - len(turns)) for turns in (first, second))
    both = [a + b for a, b in zip(first, second, strict=True)]
    expected = []
    begins = planned(start_us, (n * PERIOD_US for n in range(15)), both)
    for begin_us, cost_us in zip(begins, first, strict=True):
        expected += [("A", begin_us), ("B", begin_us + cost_us)]
    assert log == expected


@given(st.lists(costs, min_size=3, max_size=3))
def test_slot_m_of_cycle_n_begins_n_cycles_after_its_start(costs_us: list[list[int]]):
    clock, log = ManualClock(7_000_000), Log()
    names = ["A", "B", "C"]
    machines = [worker(*both) for both in zip(names, [clock] * 3, [log] * 3, costs_us, strict=True)]
    slots = [("A", 0), ("B", 100), ("A", 1_000), ("C", 1_000), ("B", 1_900)]
    timetable = Timetable([TimeSlot(name, start, 50) for name, start in slots], 2_000)
    Arrangement(machines, clock=clock, timetable=timetable).run(max_rounds=8)
    order = [slots[n % 5][0] for n in range(40)]
    assert [name for name, _ in log] == order  # none left out
    left = {name: iter(of + [0] * 40) for name, of in zip(names, costs_us, strict=True)}
    begins = ((n // 5) * 2_000 + slots[n % 5][1] for n in range(40))
    assert [us for _, us in log] == planned(7_000, begins, [next(left[name]) for name in order])


def test_the_timetable_and_not_the_order_of_loading_gives_the_token():
    clock, log = ManualClock(), Log()
    timetable = Timetable.meeting(
        [Requirement("B", 1_000, 100, (0, 500)), Requirement("A", 2_000, 100, (0,))]
    )
    machines = [worker("A", clock, log), worker("B", clock, log)]
    Arrangement(machines, clock=clock, timetable=timetable).run(max_rounds=2)
    cycle = [("B", 0), ("A", 0), ("B", 500), ("B", 1_000), ("B", 1_500)]
    assert log == [(name, n * 2_000 + us) for n in range(2) for name, us in cycle]


def test_a_round_asked_for_by_hand_waits_for_its_time_too():
    clock, log = ManualClock(), Log()
    arrangement = Arrangement([worker("A", clock, log)], clock=clock, period_us=1_000)
    for _ in range(3):
        arrangement.round()
    assert log == [("A", 0), ("A", 1_000), ("A", 2_000)]


def test_nothing_is_waited_for_after_the_last_round():
    clock = ManualClock()
    arrangement = Arrangement([Stubborn], clock=clock, period_us=1_000)
    assert arrangement.run(max_rounds=3) is Reason.MAX_ROUNDS
    assert clock.now_ns() == 2_000_000


def test_turns_on_a_grid_are_waited_for_whatever_the_idle_time_is():
    trace = Trace()
    arrangement = Arrangement(
        [Stubborn], clock=ManualClock(), period_us=1_000, idle_us=77, observers=[trace]
    )
    arrangement.run(max_rounds=3)
    sleeps = [event.duration_ns for event in trace if isinstance(event, IdleSleep)]
    assert sleeps == [1_000_000, 1_000_000]


@pytest.mark.parametrize("timetable", [None, Timetable([TimeSlot("A", 0, 1_000)], 1_000)])
def test_looking_at_the_board_delays_no_turn(timetable: Timetable | None):
    clock, log = ManualClock(), Log()

    class SlowBoard(LocalBoard):
        @property
        def alive(self) -> bool:
            clock.advance(us=100)
            return True

    period = {"period_us": 1_000} if timetable is None else {"timetable": timetable}
    machines = [worker("A", clock, log)]
    arrangement = Arrangement(machines, whiteboard=SlowBoard(), clock=clock, **period)
    arrangement.run(max_rounds=5)
    first_us = log[0][1]
    assert [us - first_us for _, us in log] == [0, 1_000, 2_000, 3_000, 4_000]


# Far behind


class Plan:
    """A pacer of which every round is wanted, asked for one after another."""

    def __init__(self, cycle_us: int) -> None:
        self.clock = ManualClock()
        self.pacer = Pacer(cycle_us, self.clock, self._sleep)

    def _sleep(self, until_ns: int) -> bool:
        self.clock.sleep_until_ns(until_ns)
        return True

    def begin(self, cost_ms: float = 0) -> tuple[float, float]:
        """Begin a round that takes so long; return when it was due and when it began, in ms."""
        assert self.pacer.wait_for_round()
        due_ms, begin_ms = self.pacer.due_ns / 1e6, self.clock.now_ns() / 1e6
        self.clock.advance(ms=cost_ms)
        return due_ms, begin_ms


def test_up_to_a_second_behind_no_round_is_left_out():
    plan = Plan(100_000)
    assert plan.begin(cost_ms=1_100) == (0, 0)
    late = [plan.begin() for _ in range(13)]
    assert late == [(100 * n, max(1_100, 100 * n)) for n in range(1, 14)]
    assert plan.pacer.skipped == 0


def test_further_behind_whole_rounds_are_left_out_and_counted(caplog: pytest.LogCaptureFixture):
    plan = Plan(100_000)
    plan.begin(cost_ms=1_130)
    assert plan.begin() == (1_100, 1_130)  # 100 to 1000 are left out; still on the grid
    assert plan.begin() == (1_200, 1_200)
    assert plan.pacer.skipped == 10
    assert [record.message for record in caplog.records] == [
        "1.03 s behind: 10 rounds are left out"
    ]


def test_the_rounds_left_out_add_up():
    plan = Plan(500_000)
    plan.begin(cost_ms=2_000)
    assert plan.begin(cost_ms=3_600) == (2_000, 2_000)
    assert plan.begin() == (5_500, 5_600)
    assert plan.pacer.skipped == 3 + 6


def test_of_long_rounds_one_may_be_late(caplog: pytest.LogCaptureFixture):
    plan = Plan(10_000_000)
    plan.begin(cost_ms=19_999)
    assert plan.begin(cost_ms=21_001) == (10_000, 19_999)
    assert caplog.records == []
    assert plan.begin() == (40_000, 41_000)
    assert plan.pacer.skipped == 2


def test_a_stopped_process_goes_on_with_the_round_that_is_due():
    clock, log = ManualClock(), Log()
    machines = [worker("A", clock, log, [0, 0, 3_600_000_000])]
    arrangement = Arrangement(machines, clock=clock, period_us=1_000)
    arrangement.run(max_rounds=6)
    hour_us = 3_600_000_000
    late_us = hour_us + 2_000  # just when a round is due
    assert [us for _, us in log] == [0, 1_000, 2_000, late_us, late_us + 1_000, late_us + 2_000]


# Overruns


@given(costs, costs)
def test_overruns_are_of_the_machine_whose_turn_ended_too_late(a: list[int], b: list[int]):
    clock, log = ManualClock(), Log()
    timetable = Timetable([TimeSlot("A", 0, 400), TimeSlot("B", 500, 500)], 1_000)
    machines = [worker("A", clock, log, a), worker("B", clock, log, b)]
    arrangement = Arrangement(machines, clock=clock, timetable=timetable)
    arrangement.run(max_rounds=12)
    costs_us = {"A": iter(a + [0] * 12), "B": iter(b + [0] * 12)}
    over: dict[str, list[int]] = {"A": [], "B": []}
    for n, (name, begin_us) in enumerate(log):
        deadline_us = (n // 2) * 1_000 + (400 if name == "A" else 1_000)
        over[name].append(begin_us + next(costs_us[name]) - deadline_us)
    for counted in arrangement.statistics():
        late = [us for us in over[counted.machine] if us > 0]
        assert counted.overruns == len(late)
        assert counted.worst_overrun_us == max(late, default=0)


def test_a_turn_of_a_period_is_in_time_until_the_next_round_is_due(
    caplog: pytest.LogCaptureFixture,
):
    clock, log = ManualClock(), Log()
    machines = [
        worker("Punctual", clock, log, [400, 0, 0, 0]),
        worker("Late", clock, log, [600, 1_001, 1_500]),  # the third begins 1 us late
        worker("Last", clock, log, [0, 0, 0, 99]),
    ]
    arrangement = Arrangement(machines, clock=clock, period_us=1_000)
    arrangement.run(max_rounds=6)
    overruns = {of.machine: (of.overruns, of.worst_overrun_us) for of in arrangement.statistics()}
    assert overruns == {"Punctual": (0, 0), "Late": (2, 501), "Last": (2, 501)}
    assert [record.message for record in caplog.records] == [
        "Late: 2 of 6 turns ended after their deadline, the worst by 501 us",
        "Last: 2 of 6 turns ended after their deadline, the worst by 501 us",
    ]
    assert {record.levelno for record in caplog.records} == {logging.WARNING}


def test_a_run_in_time_warns_of_nothing(caplog: pytest.LogCaptureFixture):
    clock = ManualClock()
    machines = [worker("A", clock, [], [1_000, 1_000])]
    Arrangement(machines, clock=clock, period_us=1_000).run(max_rounds=3)
    assert caplog.records == []


# Who has slots


def test_the_slots_of_a_machine_that_is_gone_stay_empty_until_its_name_is_back():
    clock, log = ManualClock(), Log()
    slots = [TimeSlot("ABAC"[n], 100 * n, 99) for n in range(4)]
    timetable = Timetable(slots, 400)
    a, b, c = (worker(name, clock, log) for name in "ABC")
    arrangement = Arrangement([a, b, c], clock=clock, timetable=timetable)
    arrangement.unload("A")
    arrangement.round()
    assert log == [("B", 100), ("C", 300)]
    arrangement.load(a)
    arrangement.round()
    assert log[2:] == [("A", 400), ("B", 500), ("A", 600), ("C", 700)]


def test_a_slot_of_a_machine_that_was_never_loaded_is_empty():
    clock, log = ManualClock(), Log()
    timetable = Timetable([TimeSlot("Nobody", 0, 99), TimeSlot("A", 10, 99)], 100)
    Arrangement([worker("A", clock, log)], clock=clock, timetable=timetable).run(max_rounds=2)
    assert log == [("A", 10), ("A", 110)]


def test_a_machine_loaded_in_a_cycle_has_its_slots_that_are_ahead():
    clock, log = ManualClock(), Log()
    late = worker("Late", clock, log)

    class Loader(Machine):
        a = State()
        b = State()
        a.to(b, when=lambda m: False)

        @a.on_entry
        def _(self) -> None:
            self.load(late)

    slots = [TimeSlot("Late", 0, 9), TimeSlot("Loader", 10, 9), TimeSlot("Late", 20, 9)]
    arrangement = Arrangement([Loader], clock=clock, timetable=Timetable(slots, 100))
    arrangement.run(max_rounds=2)
    assert log == [("Late", 20), ("Late", 100), ("Late", 120)]


def test_a_machine_without_a_slot_is_not_loaded():
    timetable = Timetable([TimeSlot("Waiting", 0, 9), TimeSlot("Other", 5, 9)], 10)
    arrangement = Arrangement([Waiting], timetable=timetable)
    no_slot = "Stubborn has no slot in the timetable; it has slots for: Waiting, Other"
    with pytest.raises(LoadError, match=no_slot):
        arrangement.load(Stubborn)
    with pytest.raises(LoadError, match=no_slot):
        arrangement.load_suspended(Stubborn)
    with pytest.raises(LoadError, match=r"Waiting\.0 has no slot"):
        arrangement.load(Waiting)
    assert arrangement.load(Waiting, name="Other") == 1
    assert [machine.name for machine in arrangement.machines] == ["Waiting", "Other"]


def test_a_period_or_a_timetable_but_not_both():
    timetable = Timetable([TimeSlot("A", 0, 9)], 10)
    with pytest.raises(OptionError, match="give period_us or a timetable, not both"):
        Arrangement(period_us=10, timetable=timetable)


# How runs end

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
            said, _ = process.communicate(timeout=10)  # of the fifty minutes to the next turn
        finally:
            process.kill()
    assert said.splitlines()[-1] == "stopped SIGTERM"
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


# Under run_until


def test_run_until_keeps_the_grid():
    clock, log = ManualClock(), Log()
    machines = [worker("A", clock, log, [300])]
    arrangement = Arrangement(machines, clock=clock, period_us=1_000)
    assert run_until(arrangement, lambda now: now.rounds == 4, within_ms=10) == 3
    assert [us for _, us in log] == [0, 1_000, 2_000, 3_000]


def test_run_until_takes_no_round_that_is_due_too_late():
    arrangement = Arrangement([Stubborn], clock=ManualClock(), period_us=TEN_S)
    with pytest.raises(NotReachedError, match="not in 100 ms"):
        run_until(arrangement, lambda now: now.rounds == 2, within_ms=100)
