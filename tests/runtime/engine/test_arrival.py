"""A machine's status tells by which transition it has come, at whatever moment it is asked for."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from llfsm.runtime import Arrangement, Machine, ManualClock, State, Trace
from llfsm.runtime.engine.events import Eval
from llfsm.runtime.presence.status_publisher import StatusPublisher
from llfsm.whiteboard import Whiteboard
from llfsm.whiteboard.messages.llfsm import status_slot
from thoroughness import examples


class Twin(Machine):
    """Two transitions lead from one state to the other."""

    first: bool = False
    second: bool = False
    back: bool = False

    a = State()
    b = State()
    rest = State(suspend=True)

    a.to(b, when=lambda m: m.first)
    a.to(b, when=lambda m: m.second)
    b.to(a, when=lambda m: m.back)


class Walk(Machine):
    """Fire in every turn."""

    a = State()
    b = State()
    c = State()
    a.to(b)
    b.to(c)
    c.to(a)


@given(
    st.lists(st.sampled_from(["first", "second", "back", "none", "suspend", "resume", "restart"])),
    st.booleans(),
)
@settings(deadline=None, max_examples=examples(60))
def test_it_is_the_transition_that_fired_last(steps: list[str], observed: bool) -> None:
    machine, clock, trace = Twin(), ManualClock(), Trace()
    arrangement = Arrangement([machine], clock=clock, observers=[trace] if observed else ())
    expected = ("", 0)
    for step in steps:
        clock.advance(ms=1)
        machine.first = machine.second = machine.back = False
        if step in ("suspend", "resume", "restart"):
            getattr(arrangement, step)("Twin")
        elif step != "none":
            setattr(machine, step, True)
        before = arrangement.state_name_of("Twin")
        arrangement.round()
        after = arrangement.state_name_of("Twin")
        if step == "restart":
            expected = ("", 0)
        elif before != after:
            ways = {("a", "b"): ("a", int(step == "second")), ("b", "a"): ("b", 0)}
            expected = ways.get((before, after), ("", 0))
        arrival = arrangement.roster.find("Twin").arrival()
        assert arrival[:2] == expected, steps
    if observed and expected[0]:
        fired = [e for e in trace if isinstance(e, Eval) and e.value]
        assert (fired[-1].state, fired[-1].transition) == expected


def test_the_status_reports_it_and_of_each_stay() -> None:
    board, clock = Whiteboard.local(), ManualClock()
    arrangement = Arrangement([Walk], whiteboard=board, clock=clock)
    presence = StatusPublisher(arrangement, board)
    reported = board.get_message(status_slot("Walk"))
    assert (reported.state, reported.source, reported.entered_ns) == ("a", "", 0)
    seen = []
    for _ in range(7):
        clock.advance(ms=10)
        arrangement.round()  # in which it enters, and fires
        presence.look(idle=True)
        reported = board.get_message(status_slot("Walk"))
        assert reported.entered_ns == 0  # it has had no turn in this state
        assert reported.in_state_s == 0.0
        seen.append((reported.state, reported.source, reported.transition))
    assert seen[:3] == [("b", "a", 0), ("c", "b", 0), ("a", "c", 0)]


@pytest.mark.parametrize("rounds", [1, 4])
def test_a_stay_has_one_moment_of_entry(rounds: int) -> None:
    board, clock = Whiteboard.local(), ManualClock()
    machine = Twin(first=True)
    arrangement = Arrangement([machine], whiteboard=board, clock=clock)
    presence = StatusPublisher(arrangement, board)
    clock.advance(ms=5)
    arrangement.round()
    entered = set()
    for _ in range(rounds):
        clock.advance(ms=300)
        arrangement.round()
        presence.look(idle=True)
        entered.add(board.get_message(status_slot("Twin")).entered_ns)
    assert entered == {305_000_000}
    assert board.get_message(status_slot("Twin")).source == "a"
