"""A machine goes on in a state without transitions that is not final."""

from __future__ import annotations

import pytest

from llfsm.runtime import Arrangement, Machine, ManualClock, State
from llfsm.runtime.checking import check_class
from llfsm.runtime.drawing import to_dot
from llfsm.runtime.verification import explore
from llfsm.whiteboard import Whiteboard


class Counting(Machine):
    """Count its turns for ever."""

    n: int = 0
    count = State(final=False)

    @count.internal
    def _(self) -> None:
        self.n = (self.n + 1) % 5


class Child(Counting):
    """Inherit the state."""


class Leaving(Counting):
    """Extend the state by a transition, after which it ends."""

    end = State()
    Counting.count.to(end, after_ms=5)


def arrangement(machine: type[Machine]) -> tuple[Arrangement, ManualClock]:
    clock = ManualClock()
    return Arrangement([machine], whiteboard=Whiteboard.local(), clock=clock), clock


@pytest.mark.parametrize("machine", [Counting, Child])
def test_its_internal_runs_in_each_turn(machine: type[Counting]) -> None:
    made, _ = arrangement(machine)
    for n in (1, 2, 3, 4, 0, 1):
        made.round()
        assert made.machine(machine.__name__).n == n
    assert made.machine(machine.__name__).state_name == "count"
    assert not check_class(machine)


def test_requests_are_as_everywhere() -> None:
    made, _ = arrangement(Counting)
    made.round()
    made.control.restart("Counting")
    made.round()
    made.control.unload("Counting")
    made.round()
    assert [*made.roster] == []


def test_with_a_transition_it_is_as_any_other() -> None:
    made, clock = arrangement(Leaving)
    made.round()
    clock.advance(ms=6)
    made.round()
    made.round()
    assert [*made.roster] == []


def test_it_is_explored_as_it_runs() -> None:
    space = explore([Counting], period_ms=10)
    assert space.complete
    assert space.states == 6  # before its first turn, and with each number


def test_it_is_not_drawn_as_a_final_one() -> None:
    assert "peripheries" not in to_dot(Counting.table)
