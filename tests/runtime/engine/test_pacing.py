"""A fixed period and a timetable: when turns begin, and which are late."""

from __future__ import annotations

import logging
from collections.abc import Iterator

import pytest
from hypothesis import given
from hypothesis import strategies as st

from llfsm.runtime import Arrangement, ManualClock, Reason, TimeSlot, Timetable, Trace
from llfsm.runtime.engine.environment import Environment
from llfsm.runtime.engine.events import IdleSleep
from llfsm.runtime.engine.schedule import Pacer
from llfsm.runtime.engine.statistics import Stopwatch
from llfsm.runtime.testing import NotReachedError, run_until
from llfsm.whiteboard.local import LocalBoard

from .paced import Log, Stubborn, worker

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
        self.stopwatch = Stopwatch(self.clock)
        self.pacer = Pacer(cycle_us, Environment(self.clock), self.stopwatch, self._sleep)

    def _sleep(self, until_ns: int) -> bool:
        self.clock.sleep_until_ns(until_ns)
        return True

    def begin(self, cost_ms: float = 0) -> tuple[float, float]:
        """Begin a round that takes so long; return when it was due and when it began, in ms."""
        assert self.pacer.wait_for_round()
        due_ms, begin_ms = self.stopwatch.due_ns / 1e6, self.clock.now_ns() / 1e6
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


# Under run_until


def test_run_until_keeps_the_grid():
    clock, log = ManualClock(), Log()
    machines = [worker("A", clock, log, [300])]
    arrangement = Arrangement(machines, clock=clock, period_us=1_000)
    assert run_until(arrangement, lambda now: now.rounds == 4, within_ms=10) == 3
    assert [us for _, us in log] == [0, 1_000, 2_000, 3_000]


def test_run_until_takes_no_round_that_is_due_too_late():
    arrangement = Arrangement([Stubborn], clock=ManualClock(), period_us=10_000_000)
    with pytest.raises(NotReachedError, match="not in 100 ms"):
        run_until(arrangement, lambda now: now.rounds == 2, within_ms=100)
