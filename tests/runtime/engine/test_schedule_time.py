"""The schedule's time: what machines see in a turn is when it was due, however late it began."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from llfsm.bridges.recording.rerun import Rerun
from llfsm.runtime import Arrangement, Machine, ManualClock, Sensor, State, TimeSlot, Timetable
from llfsm.runtime.engine.clock import DebugClock
from llfsm.runtime.engine.environment import Environment
from llfsm.runtime.journal.entries import Entry, Journal, entries_of
from llfsm.runtime.journal.journalled import JournalledEnvironment
from llfsm.whiteboard import Message, Slot
from llfsm.whiteboard.local import LocalBoard

PERIOD_US = 20_000

costs = st.lists(st.sampled_from([0, 1, 300, 19_999, 20_000, 20_001, 70_000]), max_size=30)


class Pose(Message):
    x: float = 0.0


POSE = Slot("pose", Pose)


def elapsed_us(machine: Machine) -> int:
    """Find how long a machine sees that it has been in its state, by asking it."""
    return bisect_left(range(10**9), 1, key=lambda us: not machine.timeout(us))


def waiting(
    limit_ms: float,
    cost: Callable[[], None] = lambda: None,
    guard: Callable[[Any], bool] = lambda machine: False,
) -> type[Machine]:
    """Make a machine that waits so long, again and again, and counts its turns meanwhile."""

    class Waiting(Machine):
        turns: int = 0
        counts: tuple[int, ...] = ()
        wait, again = State(), State()

        @wait.on_entry
        def _(self) -> None:
            cost()
            self.turns = 0

        @wait.internal
        def _(self) -> None:
            cost()
            self.turns += 1

        wait.to(wait, when=guard)
        wait.to(again, after_ms=limit_ms)

        @again.on_entry
        def _(self) -> None:
            self.counts = (*self.counts, self.turns)

        again.to(wait)

    return Waiting


def late_by(clock: ManualClock, costs_us: list[int]) -> Callable[[], None]:
    """Make what code of machines costs, one time after the other, and then nothing."""
    left = iter(costs_us)
    return lambda: clock.advance(us=next(left, 0))


@given(costs, st.integers(0, 7), st.integers(0, 10**9))
def test_a_wait_of_n_periods_is_n_turns_however_late_they_are(
    costs_us: list[int], periods: int, start_ns: int
):
    clock = ManualClock(start_ns)
    machine = waiting(periods * PERIOD_US / 1_000, late_by(clock, costs_us))()
    Arrangement([machine], clock=clock, period_us=PERIOD_US).run(max_rounds=40)
    assert set(machine.counts) == {periods + 1}  # as the time must be more than the limit


def test_real_turns_are_late_and_no_machine_can_tell():
    machine = waiting(3)()
    arrangement = Arrangement([machine], period_us=1_000)
    arrangement.run(max_rounds=100)
    pacer = arrangement.kernel.pacer
    assert pacer is not None
    assert set(machine.counts) == {4} or pacer.skipped


class Asking(Machine):
    """Notes the time that it sees, from its first turn on."""

    seen_us: tuple[int, ...] = ()
    on = State()

    @on.internal
    def _(self) -> None:
        self.seen_us = (*self.seen_us, elapsed_us(self))

    on.to(on, when=lambda self: False)


def test_slots_of_a_timetable_are_the_times_that_machines_see():
    clock = ManualClock()
    slow = waiting(1, lambda: clock.advance(us=700))
    slots = [TimeSlot("Slow", 0, 50), TimeSlot("Asking", 100, 50), TimeSlot("Asking", 600, 50)]
    machine = Asking()
    arrangement = Arrangement(clock=clock, timetable=Timetable(slots, 1_000))
    arrangement.load(slow, name="Slow")
    arrangement.load(machine)
    arrangement.run(max_rounds=3)
    assert machine.seen_us == (0, 500, 1_000, 1_500, 2_000, 2_500)


def test_rounds_that_are_left_out_pass_in_the_machines_time():
    clock, machine = ManualClock(), Asking()
    arrangement = Arrangement([machine], clock=clock, period_us=PERIOD_US)
    arrangement.round()
    clock.advance(s=10, us=5)
    arrangement.round()
    arrangement.round()
    assert machine.seen_us == (0, 10_000_000, 10_020_000)


def test_without_a_schedule_the_time_is_the_clocks():
    clock, machine = ManualClock(), Asking()
    arrangement = Arrangement([machine], clock=clock)
    for _ in range(3):
        arrangement.round()
        clock.advance(us=7)
    assert machine.seen_us == (0, 7, 14)


class Watching(Machine):
    """Notes how old its message is."""

    pose = Sensor(POSE, max_age_ms=40)
    ages_ms: tuple[object, ...] = ()
    on = State()

    @on.internal
    def _(self) -> None:
        age_ms = None if self.pose is None else self.age_ms("pose")
        self.ages_ms = (*self.ages_ms, age_ms)

    on.to(on, when=lambda self: False)


def test_the_age_of_a_message_is_that_when_the_turn_was_due():
    clock, machine = ManualClock(), Watching()
    board = LocalBoard(now_ns=clock.now_ns)
    late = waiting(1_000_000, lambda: clock.advance(ms=3))
    arrangement = Arrangement([late, machine], whiteboard=board, clock=clock, period_us=PERIOD_US)
    arrangement.round()
    board.add_message(POSE, Pose(1.0))  # at 6 ms
    for _ in range(4):
        arrangement.round()
    assert machine.ages_ms == (None, 14.0, 34.0, None, None)


def test_a_message_that_came_after_the_turn_was_due_is_of_age_0():
    clock, machine = ManualClock(), Watching()
    board = LocalBoard(now_ns=clock.now_ns)

    def post_late() -> None:
        clock.advance(ms=3)
        board.add_message(POSE, Pose(1.0))

    late = waiting(1_000_000, post_late)
    arrangement = Arrangement([late, machine], whiteboard=board, clock=clock, period_us=PERIOD_US)
    arrangement.round()
    arrangement.round()
    assert machine.ages_ms == (0, 0)


def test_while_a_debugger_pauses_messages_grow_old(monkeypatch: pytest.MonkeyPatch):
    host_ns = 1_000_000_000
    monkeypatch.setattr("time.monotonic_ns", lambda: host_ns)
    clock = DebugClock()
    environment = Environment(clock)
    environment.is_due(clock.now_ns())
    before_ns = environment.machine_now()
    with clock.stopped():
        host_ns += 50_000_000
    assert environment.machine_now() == before_ns
    assert clock.behind_ns == 50_000_000


# Recorded, and run again


def recorded(machine: Machine, costs_us: list[int]) -> list[Entry]:
    """Record a run of 30 rounds in which code costs so much."""
    entries: list[Entry] = []
    journal = Journal(lambda data: entries.extend(entries_of(data)))
    clock = ManualClock(5)
    environment = JournalledEnvironment(Environment(clock), journal)
    arrangement = Arrangement(environment=environment, period_us=PERIOD_US)
    with journal.asking():
        arrangement.load(machine)
    for cost_us in [*costs_us, *[0] * (30 - len(costs_us))]:
        arrangement.round()
        clock.advance(us=cost_us)
    journal.flush()
    return entries


@given(costs)
def test_a_run_again_sees_the_times_when_turns_were_due(costs_us: list[int]):
    first, again = waiting(60)(), waiting(60)()
    entries = recorded(first, costs_us)
    rerun = Rerun(entries)
    rerun.arrange([again])
    assert rerun.compare() is None
    assert again.counts == first.counts


def test_a_machine_that_asks_for_the_time_more_often_sees_the_same():
    entries = recorded(waiting(60)(), [300, 70_000, 19_999])

    seen_us: list[int] = []

    def ask_again(machine: Any) -> bool:
        seen_us.append(elapsed_us(machine))
        return False

    rerun = Rerun(entries, how="states")
    rerun.arrange([waiting(60, guard=ask_again)()])
    assert rerun.compare() is None
    assert any(seen_us)
    assert all(us % PERIOD_US == 0 for us in seen_us)
