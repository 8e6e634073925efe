"""Machines and their slots in a timetable: who has a turn, and who is not loaded."""

from __future__ import annotations

import pytest

from llfsm.runtime import (
    Arrangement,
    LoadError,
    Machine,
    ManualClock,
    OptionError,
    Requirement,
    State,
    TimeSlot,
    Timetable,
)

from .paced import Log, Stubborn, Waiting, worker


def test_the_timetable_and_not_the_order_of_loading_gives_the_token():
    clock, log = ManualClock(), Log()
    timetable = Timetable.meeting(
        [Requirement("B", 1_000, 100, (0, 500)), Requirement("A", 2_000, 100, (0,))]
    )
    machines = [worker("A", clock, log), worker("B", clock, log)]
    Arrangement(machines, clock=clock, timetable=timetable).run(max_rounds=2)
    cycle = [("B", 0), ("A", 0), ("B", 500), ("B", 1_000), ("B", 1_500)]
    assert log == [(name, n * 2_000 + us) for n in range(2) for name, us in cycle]


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
