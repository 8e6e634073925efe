"""What each machine did and how long it took, if its turns are timed."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from llfsm.runtime import (
    Arrangement,
    ExecutionError,
    Machine,
    MachineStatistics,
    ManualClock,
    OptionError,
    State,
    TimeSlot,
    Timetable,
    define,
)

from .quantiles import TOLERANCE, exact


def ring(name: str, clock: ManualClock, costs_ns: list[int]) -> Any:
    """Return a machine that goes round three states for ever; its n-th turn takes costs_ns[n]."""
    costs = iter(costs_ns)
    states = [State("A"), State("B"), State("C")]
    for state, following in zip(states, states[1:] + states[:1], strict=True):
        state.on_exit(lambda machine: clock.advance(ns=next(costs, 0)))
        state.to(following)
    return define(name, states)


class Three(Machine):
    """Stay 20 ms in `a`, 30 ms in `b`, then accept."""

    a = State()
    b = State()
    c = State()
    a.to(b, after_ms=19.5)
    b.to(c, after_ms=29.5)


class Idle(Machine):
    a = State()
    b = State()
    a.to(b, when=lambda m: False)


class Brief(Machine):
    a = State()
    b = State()
    a.to(b)


def statistics(arrangement: Arrangement) -> dict[str, MachineStatistics]:
    return {of.machine: of for of in arrangement.statistics()}


def about(us: float) -> Any:
    """Match a spread of values that are all the same."""
    return (pytest.approx(us, rel=TOLERANCE), pytest.approx(us, rel=TOLERANCE), us)


# Counts


def test_turns_that_are_not_timed_have_no_statistics():
    arrangement = Arrangement([Idle])
    with pytest.raises(OptionError, match="not timed: make the Arrangement with timed=True"):
        arrangement.statistics()


@pytest.mark.parametrize(
    "how",
    [
        {"timed": True},
        {"period_us": 1_000},
        {"timetable": Timetable([TimeSlot("R", 0, 9), TimeSlot("Idle", 0, 9)], 1_000)},
    ],
)
def test_ringlets_and_transitions_are_counted(how: dict[str, Any]):
    clock = ManualClock()
    arrangement = Arrangement([ring("R", clock, []), Idle], clock=clock, **how)
    arrangement.run(max_rounds=7)
    counts = [(of.machine, of.ringlets, of.fired) for of in arrangement.statistics()]
    assert counts == [("R", 7, 7), ("Idle", 7, 0)]


def test_without_a_plan_there_is_no_jitter_and_no_overrun():
    clock = ManualClock()
    arrangement = Arrangement([ring("R", clock, [10**10] * 9)], clock=clock, timed=True)
    arrangement.run(max_rounds=7)
    (of,) = arrangement.statistics()
    assert (of.jitter_us, of.overruns, of.worst_overrun_us) == (None, 0, 0)


def test_a_machine_that_is_gone_keeps_its_statistics_and_its_place():
    arrangement = Arrangement([Three, Idle], clock=ManualClock(), timed=True)
    arrangement.run(max_rounds=20)
    assert len(arrangement.machines) == 1
    assert [of.machine for of in arrangement.statistics()] == ["Three", "Idle"]
    three = statistics(arrangement)["Three"]
    assert (three.fired, three.ringlets) == (2, 8)
    assert three.state_s == {"a": 0.02, "b": 0.03, "c": 0}


def test_machines_of_one_name_are_counted_together_one_after_another():
    clock = ManualClock()
    arrangement = Arrangement([Idle], clock=clock, timed=True)
    arrangement.round()
    clock.advance(s=1)
    arrangement.unload("Idle")
    clock.advance(s=100)  # nobody is in any state
    arrangement.load(Idle)
    arrangement.round()
    clock.advance(s=2)
    (idle,) = arrangement.statistics()
    assert (idle.ringlets, idle.state_s) == (2, {"a": 3.0})


def loaded(arrangement: Arrangement) -> None:
    arrangement.load(Idle)


def loaded_suspended(arrangement: Arrangement) -> None:
    arrangement.load_suspended(Idle)


def suspended_at_once(arrangement: Arrangement) -> None:
    arrangement.load(Idle)
    arrangement.suspend("Idle")


def resumed(arrangement: Arrangement) -> None:
    arrangement.load_suspended(Idle)
    arrangement.resume("Idle")


def restarted(arrangement: Arrangement) -> None:
    arrangement.load_suspended(Idle)
    arrangement.restart("Idle")


def abandoned(arrangement: Arrangement) -> None:
    arrangement.load(Idle)
    arrangement.control.abandon("Idle")


@pytest.mark.parametrize("timed", [False, True])
@pytest.mark.parametrize(
    ("begin", "besides"),
    [
        (loaded, 0),
        (loaded_suspended, 0),
        (suspended_at_once, 0),
        (resumed, 0),
        (restarted, 0),
        (abandoned, 1),
    ],
)
def test_every_ringlet_is_counted_however_a_machine_begins(
    begin: Callable[[Arrangement], None], besides: int, timed: bool
):
    arrangement = Arrangement([Three], clock=ManualClock(), timed=timed)
    for _ in range(3):
        arrangement.round()
    begin(arrangement)
    assert arrangement.roster.find("Idle").progress == (besides, 0)
    for rounds in range(1, 4):
        arrangement.round()
        assert arrangement.roster.find("Idle").progress == (rounds + besides, 0)
    arrangement.restart("Idle")
    arrangement.round()
    assert arrangement.roster.find("Idle").progress == (4 + besides, 0)


def test_a_turn_that_fails_counts_and_is_timed():
    clock = ManualClock()

    class Fails(Machine):
        a = State()

        @a.on_entry
        def _(self) -> None:
            clock.advance(us=40)
            raise ValueError

    arrangement = Arrangement([Fails], clock=clock, timed=True)
    with pytest.raises(ExecutionError):
        arrangement.round()
    (fails,) = arrangement.statistics()
    assert (fails.ringlets, fails.fired, fails.cost_us) == (1, 0, about(40))
    assert fails.state_s == {"a": 40e-6}


# Time in states


@given(
    st.lists(st.integers(0, 10**7), max_size=30),
    st.lists(st.integers(0, 10**7), max_size=30),
    st.sampled_from([{}, {"period_us": 3_000}]),
)
def test_the_times_in_states_sum_to_the_time_since_the_first_turn(
    first: list[int], second: list[int], schedule: dict[str, Any]
):
    clock = ManualClock(12_345)
    machines = [ring("R", clock, first), ring("S", clock, second), Idle]
    arrangement = Arrangement(machines, clock=clock, timed=True, **schedule)
    begin_ns = {"R": 12_345, "S": 12_345 + sum(first[:1])}
    begin_ns["Idle"] = begin_ns["S"] + sum(second[:1])
    arrangement.run(max_rounds=20)
    for name, counted in statistics(arrangement).items():
        passed_s = (clock.now_ns() - begin_ns[name]) / 1e9
        assert sum(counted.state_s.values()) == pytest.approx(passed_s, abs=1e-9)


def test_a_turn_belongs_to_the_state_in_which_it_began():
    clock = ManualClock()
    arrangement = Arrangement([ring("R", clock, [10**9, 2 * 10**9])], clock=clock, timed=True)
    arrangement.round()  # A: one second, then idle for three
    clock.advance(s=3)
    arrangement.round()  # B: two seconds
    assert statistics(arrangement)["R"].state_s == {"A": 4.0, "B": 2.0}


def test_suspended_time_is_that_of_the_suspend_state():
    clock = ManualClock()
    arrangement = Arrangement([Idle], clock=clock, timed=True)
    arrangement.round()
    clock.advance(s=1)
    arrangement.suspend("Idle")
    arrangement.round()
    clock.advance(s=2)
    arrangement.restart("Idle")
    arrangement.round()
    clock.advance(s=4)
    assert statistics(arrangement)["Idle"].state_s == {"a": 5.0, "Suspended": 2.0}


def test_a_machine_that_unloads_itself_rests_from_the_end_of_its_turn():
    clock = ManualClock()

    class Leaves(Machine):
        a = State()

        @a.on_entry
        def _(self) -> None:
            self.unload(self.name)
            clock.advance(s=1)

    arrangement = Arrangement([Leaves, Idle], clock=clock, timed=True)
    arrangement.round()
    clock.advance(s=7)
    assert statistics(arrangement)["Leaves"].state_s == {"a": 1.0}


def test_a_machine_that_takes_the_name_of_one_asked_to_stop_is_timed_on():
    clock = ManualClock()
    arrangement = Arrangement([Brief, Idle], clock=clock, timed=True)
    arrangement.stop_machine("Brief")
    arrangement.round()
    arrangement.round()  # it accepts
    assert len(arrangement.machines) == 1
    arrangement.load(Idle, name="Brief")
    arrangement.round()
    clock.advance(s=1)
    arrangement.control.unload_stopped(grace_ns=0)  # the one that was asked is long gone
    clock.advance(s=2)
    assert statistics(arrangement)["Brief"].state_s == {"a": 3.0, "b": 0.0}


def test_after_the_end_no_time_is_counted():
    clock = ManualClock()
    arrangement = Arrangement([Idle], clock=clock, timed=True)
    arrangement.run(max_rounds=3)
    at_end = arrangement.statistics()
    clock.advance(s=3_600)
    assert arrangement.statistics() == at_end


# What turns cost


@given(st.lists(st.integers(0, 10**6), min_size=1, max_size=8), st.integers(1, 10**6))
def test_time_between_rounds_is_no_cost(costs_ns: list[int], pause_ns: int):
    clock = ManualClock()
    arrangement = Arrangement([ring("R", clock, costs_ns), Idle], clock=clock, timed=True)
    for _ in costs_ns:
        clock.advance(ns=pause_ns)
        arrangement.round()
    found = statistics(arrangement)
    assert found["R"].cost_us.max == max(costs_ns) / 1e3
    assert found["Idle"].cost_us == (0, 0, 0)


def test_a_turn_around_another_one_costs_both():
    clock = ManualClock()

    class Inner(Idle):
        @Idle.a.on_suspend
        def _(self) -> None:
            clock.advance(us=5)

    class Outer(Machine):
        a = State()
        b = State()

        @a.on_entry
        def _(self) -> None:
            clock.advance(us=2)
            self.abandon("Inner")
            clock.advance(us=3)

        a.to(b)

    arrangement = Arrangement([Inner, Outer], clock=clock, timed=True)
    arrangement.run(max_rounds=1)
    found = statistics(arrangement)
    assert (found["Inner"].cost_us.max, found["Outer"].cost_us.max) == (5, 10)


@given(st.lists(st.integers(0, 10**7), min_size=1, max_size=20), st.booleans())
def test_the_costs_of_machines_are_told_apart(costs_ns: list[int], observed: bool):
    clock, rounds = ManualClock(), len(costs_ns)
    machines = [ring("R", clock, costs_ns), Idle]
    arrangement = Arrangement(machines, clock=clock, timed=True)
    if observed:  # binds the machines again
        arrangement.attach(lambda event: None)
    arrangement.run(max_rounds=rounds)
    found = statistics(arrangement)
    cost_us = found["R"].cost_us
    assert cost_us.max == max(costs_ns) / 1e3
    assert cost_us.p50 == pytest.approx(exact(50, costs_ns), rel=TOLERANCE)
    assert found["Idle"].cost_us == (0, 0, 0)
    assert (found["R"].ringlets, found["R"].fired, found["R"].jitter_us) == (rounds, rounds, None)


def test_the_costs_of_a_machine_that_is_gone_remain():
    clock = ManualClock()

    class Once(Machine):
        a = State()

        @a.on_entry
        def _(self) -> None:
            clock.advance(us=20)

    arrangement = Arrangement([Once, Idle], clock=clock, period_us=1_000)
    arrangement.run(max_rounds=5)
    once = statistics(arrangement)["Once"]
    assert once[:8] == MachineStatistics("Once", 1, 0, {"a": 20e-6}, about(20), None, 0, 0)[:8]


# Jitter


@given(st.lists(st.integers(0, 4_000_000), min_size=2, max_size=12))
def test_jitter_is_how_much_the_time_between_turns_differs_from_the_planned(costs_ns: list[int]):
    clock = ManualClock()
    arrangement = Arrangement([ring("R", clock, costs_ns)], clock=clock, period_us=1_000)
    arrangement.run(max_rounds=12)
    begins_ns, free_ns = [], 0
    for n, cost_ns in enumerate(costs_ns + [0] * (12 - len(costs_ns))):
        begins_ns.append(max(n * 1_000_000, free_ns))
        free_ns = begins_ns[-1] + cost_ns
    gaps_ns = [after - before for before, after in pairwise(begins_ns)]
    jitters_ns = [abs(gap_ns - 1_000_000) for gap_ns in gaps_ns]
    jitter_us = statistics(arrangement)["R"].jitter_us
    assert jitter_us is not None
    assert jitter_us.max == max(jitters_ns) / 1e3
    assert jitter_us.p50 == pytest.approx(exact(50, jitters_ns), rel=TOLERANCE)


def test_uneven_slots_that_are_kept_are_no_jitter():
    slots = [TimeSlot("Idle", 0, 9), TimeSlot("Idle", 300, 9)]
    arrangement = Arrangement([Idle], clock=ManualClock(), timetable=Timetable(slots, 1_000))
    arrangement.run(max_rounds=4)
    assert statistics(arrangement)["Idle"].jitter_us == (0, 0, 0)


def test_the_time_without_a_machine_is_no_jitter():
    clock = ManualClock()
    arrangement = Arrangement([Idle, Three], clock=clock, period_us=1_000)
    arrangement.round()
    arrangement.unload("Idle")
    arrangement.round()
    clock.advance(us=1_400)
    arrangement.load(Idle)
    arrangement.round()  # at 2.4 ms instead of 2
    clock.advance(us=900)
    arrangement.round()  # at 3.3 instead of 3
    assert statistics(arrangement)["Idle"].jitter_us == about(100)
