"""Timetables: when whose turn begins, and which timetables cannot be."""

from __future__ import annotations

from itertools import islice

import pytest
from hypothesis import given
from hypothesis import strategies as st

from llfsm.runtime import Requirement, ScheduleError, TimeSlot, Timetable


def turns(timetable: Timetable, cycles: int) -> list[tuple[int, str]]:
    """Return (time, machine) of each turn of so many cycles, in the timetable's order."""
    return [
        (cycle * timetable.cycle_us + slot.start_us, slot.machine)
        for cycle in range(cycles)
        for slot in timetable.slots
    ]


@st.composite
def requirements(draw: st.DrawFn) -> list[Requirement]:
    needs = []
    for number in range(draw(st.integers(1, 4))):
        period_us = draw(st.sampled_from([1, 2, 3, 4, 6, 10, 12, 15, 20]))
        starts_us = draw(st.sets(st.integers(0, period_us - 1), min_size=1, max_size=3))
        order = draw(st.permutations(sorted(starts_us)))
        needs.append(Requirement(f"m{number}", period_us, draw(st.integers(1, 50)), tuple(order)))
    return needs


@given(requirements())
def test_each_machine_has_its_turn_at_each_start_of_every_period(needs: list[Requirement]):
    timetable = Timetable.meeting(needs)
    found = turns(timetable, 3)
    for need in needs:
        wanted = (n * need.period_us + s for n in range(10_000) for s in sorted(need.starts_us))
        mine = [time_us for time_us, machine in found if machine == need.machine]
        assert mine == list(islice(wanted, len(mine)))
        assert len(mine) == 3 * timetable.cycle_us // need.period_us * len(need.starts_us)
        deadlines = {slot.deadline_us for slot in timetable.slots if slot.machine == need.machine}
        assert deadlines == {need.deadline_us}


@given(requirements())
def test_turns_are_in_order_of_time_and_at_the_same_time_as_listed(needs: list[Requirement]):
    listed = [need.machine for need in needs]
    found = turns(Timetable.meeting(needs), 2)
    assert found == sorted(found, key=lambda turn: (turn[0], listed.index(turn[1])))


@given(requirements())
def test_the_cycle_is_the_shortest_in_which_all_periods_come_out_even(needs: list[Requirement]):
    cycle_us = Timetable.meeting(needs).cycle_us
    even = [us for us in range(1, cycle_us + 1) if all(us % need.period_us == 0 for need in needs)]
    assert even == [cycle_us]


def test_a_timetable_by_hand_keeps_its_slots():
    slots = [TimeSlot("A", 0, 100), TimeSlot("B", 0, 50), TimeSlot("A", 700, 300)]
    timetable = Timetable(iter(slots), 1_000)
    assert timetable.slots == tuple(slots)
    assert timetable.machines == ("A", "B")


def test_slots_may_reach_beyond_the_cycle_if_they_all_fit_into_one():
    timetable = Timetable([TimeSlot("A", 600, 10), TimeSlot("B", 1_599, 10)], 1_000)
    assert turns(timetable, 2) == [(600, "A"), (1_599, "B"), (1_600, "A"), (2_599, "B")]


@pytest.mark.parametrize(
    ("slots", "cycle_us", "message"),
    [
        ([], 1_000, "a timetable needs a slot"),
        ([TimeSlot("A", -1, 5)], 1_000, "A: starts at -1 us, before 0"),
        ([TimeSlot("A", 0, 0)], 1_000, "A: its deadline is 0 us; it must be 1 or more"),
        (
            [TimeSlot("A", 500, 5), TimeSlot("B", 499, 5)],
            1_000,
            "B starts at 499 us, but the slot before it, of A, at 500 us: list slots in order",
        ),
        (
            [TimeSlot("A", 0, 5), TimeSlot("B", 1_000, 5)],
            1_000,
            "the slots from 0 to 1000 us do not fit into a cycle of 1000 us",
        ),
        ([TimeSlot("A", 0, 5)], 0, "do not fit into a cycle of 0 us"),
        ([TimeSlot("A", 0, 5)], -3, "do not fit into a cycle of -3 us"),
    ],
)
def test_impossible_timetables(slots: list[TimeSlot], cycle_us: int, message: str):
    with pytest.raises(ScheduleError, match=message):
        Timetable(slots, cycle_us)


@pytest.mark.parametrize(
    ("needs", "message"),
    [
        ([], "a timetable needs a slot"),
        ([Requirement("A", 0, 5)], "A: its period is 0 us; it must be 1 or more"),
        ([Requirement("A", 100, 0)], "A: its deadline is 0 us"),
        (
            [Requirement("A", 100, 5, (100,))],
            "A: 100 us is not a start within its period of 100 us",
        ),
        ([Requirement("A", 100, 5, (0, -1))], "A: -1 us is not a start within its period"),
        (
            [Requirement("A", 1_000_003, 5), Requirement("B", 999_983, 5)],
            r"the periods have 999986 s in common, 1999986 turns; choose periods that are "
            r"multiples of each other \(at most 100000 turns\)",
        ),
    ],
)
def test_requirements_that_cannot_be_met(needs: list[Requirement], message: str):
    with pytest.raises(ScheduleError, match=message):
        Timetable.meeting(needs)


def test_as_many_turns_as_allowed_and_no_more():
    assert len(Timetable.meeting([Requirement("A", 100_000, 5, tuple(range(100_000)))]).slots)
    with pytest.raises(ScheduleError, match="100001 turns"):
        Timetable.meeting([Requirement("A", 100_001, 5, tuple(range(100_001)))])


def test_a_machine_that_would_never_have_a_turn_is_refused():
    with pytest.raises(ScheduleError, match="A"):
        Timetable.meeting([Requirement("A", 100, 5, ()), Requirement("B", 100, 5)])
