"""Responses that come, come late, or never come; and what watches."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from llfsm.runtime import Actuator, Machine, Sensor, State
from llfsm.runtime.counterexamples import replay
from llfsm.runtime.verification import (
    PredicateError,
    Property,
    Verdict,
    always_possible,
    eventually_always,
    every,
    explore,
    leads_to,
    monitor,
)
from llfsm.whiteboard import Message, Slot


class Call(Message):
    made: bool = False


class Bell(Message):
    rings: bool = False


CALL, BELL = Slot("lift/call", Call), Slot("lift/bell", Bell)


class Lift(Machine):
    """Ring 300 ms after a call, if it is still made then; end after the third."""

    call = Sensor(CALL, default=Call(), domain=every(Call))
    bell = Actuator(BELL)
    rung: int = 0

    IDLE = State()
    WAITING = State()
    RINGING = State()
    WORN = State()

    @RINGING.on_entry
    def _(self) -> None:
        self.bell(Bell(True))
        self.rung += 1

    @RINGING.on_exit
    def _(self) -> None:
        self.bell(Bell(False))

    IDLE.to(WAITING, when=lambda self: self.call.made)
    WAITING.to(RINGING, after_ms=300, when=lambda self: self.call.made)
    RINGING.to(WORN, after_ms=100, when=lambda self: self.rung == 3)
    RINGING.to(IDLE, after_ms=100)


def verdict_of(prop: Property, machine: type[Machine] = Lift) -> Verdict:
    space = explore(machine, period_ms=100, properties=[prop])
    (verdict,) = space.verdicts
    if verdict.witness is not None:
        views = replay(space, verdict.witness)
        end = len(verdict.witness.turns)
        trigger, response = prop.functions
        loop = verdict.witness.loop
        begin = max(n for n in range(end + 1) if trigger(views[n]))
        assert not any(response(view) for view in views[begin : end + 1])
        if loop is not None:
            first, last = views[loop], views[end]
            assert (first.Lift.state, first.Lift.rung) == (last.Lift.state, last.Lift.rung)
            for assumed in prop.assuming:
                assert any(assumed(view) for view in views[loop + 1 : end + 1])
    return verdict


def waiting(v: object) -> bool:
    return v.Lift.state == "WAITING"  # type: ignore[attr-defined, no-any-return]


def ringing(v: object) -> bool:
    return v.Lift.state == "RINGING"  # type: ignore[attr-defined, no-any-return]


def calling(v: object) -> bool:
    return v.Lift.call.made  # type: ignore[attr-defined, no-any-return]


def test_without_an_assumption_the_call_is_never_made_again() -> None:
    verdict = verdict_of(leads_to(waiting, ringing))
    assert verdict.holds is False
    assert verdict.witness is not None
    assert verdict.witness.loop is not None


def test_a_call_again_and_again_is_not_enough_to_be_seen_at_the_right_time() -> None:
    """It may be there only before the 300 ms are over, in the first of its turns."""
    assert verdict_of(leads_to(waiting, ringing, assuming=calling)).holds is True
    assert verdict_of(leads_to(ringing, waiting, assuming=calling)).holds is False


def test_an_execution_that_ends_answers_nothing_more() -> None:
    verdict = verdict_of(leads_to(lambda v: v.Lift.state == "WORN", waiting))
    assert verdict.holds is False
    assert verdict.witness is not None
    assert verdict.witness.loop is None


class Eager(Lift):
    Lift.IDLE.to(Lift.RINGING)


class Timed(Machine):
    """Stay in BUSY for more than 300 ms, by steps of 100: its fifth turn there leaves it."""

    IDLE = State()
    BUSY = State()
    IDLE.to(BUSY)
    BUSY.to(IDLE, after_ms=300)


@pytest.mark.parametrize(("within_ms", "holds"), [(400, False), (499, False), (500, True)])
def test_a_response_within_a_time(within_ms: float, holds: bool) -> None:
    """Entered in the round after the transition; 400 ms later, more than 300 have passed."""
    prop = leads_to(
        lambda v: v.Timed.state == "BUSY", lambda v: v.Timed.state == "IDLE", within_ms=within_ms
    )
    (verdict,) = explore(Timed, period_ms=100, properties=[prop]).verdicts
    assert verdict.holds is holds


def test_a_trigger_that_never_holds_is_reported() -> None:
    assert verdict_of(leads_to(lambda v: v.Lift.rung == 9, ringing)).vacuous
    assert not verdict_of(leads_to(ringing, lambda v: v[BELL].rings, within_ms=500)).vacuous


def test_a_time_and_an_assumption_exclude_each_other() -> None:
    with pytest.raises(PredicateError, match="not both"):
        leads_to(waiting, ringing, within_ms=10, assuming=calling)


class Counter(Machine):
    """Watch that the bell never rings twice in a row while the call is not made."""

    bell = Sensor(BELL)
    call = Sensor(CALL, default=Call())

    QUIET = State()
    ONCE = State()
    SILENT = State()
    QUIET.to(ONCE, when=lambda self: self.bell is not None and self.bell.rings)
    ONCE.to(SILENT, when=lambda self: not self.call.made)


def test_a_monitor_sees_what_the_others_saw_and_how_they_stand() -> None:
    prop = monitor(Counter, Counter.SILENT)
    space = explore(Lift, period_ms=100, properties=[prop])
    (verdict,) = space.verdicts
    assert verdict.holds is False
    assert verdict.witness is not None
    views = replay(space, verdict.witness)[: len(verdict.witness.turns) + 1]
    states = [str(view.Counter.state) for view in views]
    assert states.index("SILENT") == len(verdict.witness.turns)


def test_a_monitor_must_not_act_and_its_states_must_be_its_own() -> None:
    with pytest.raises(PredicateError, match="posts to bell"):
        monitor(Lift, Lift.WORN)
    with pytest.raises(PredicateError, match="has no state"):
        monitor(Counter, Lift.WORN)


def test_a_monitor_needs_a_name_of_its_own() -> None:
    with pytest.raises(PredicateError, match="another machine is called Counter"):
        explore([Lift, Counter], period_ms=100, properties=[monitor(Counter, Counter.SILENT)])


def test_states_never_reached_and_transitions_never_taken_are_reported() -> None:
    space = explore(Eager, period_ms=100)
    assert space.unreached == ()
    space = explore(Lift, period_ms=100, sensors={CALL: [Call(False)]})
    assert space.unreached == ("Lift.WAITING", "Lift.RINGING", "Lift.WORN")
    assert space.untaken[0] == "Lift.IDLE -> WAITING: self.call.made"
    assert len(space.untaken) == 4


# For ever, and always possible


class Drill(Machine):
    """Drill and rest; a drill that breaks is never whole again."""

    call = Sensor(CALL, default=Call(), domain=every(Call))
    worn: int = 0

    REST = State()
    DRILL = State()
    BROKEN = State()

    @DRILL.on_exit
    def _(self) -> None:
        self.worn = min(self.worn + 1, 2)

    REST.to(DRILL, when=lambda self: self.call.made)
    DRILL.to(BROKEN, when=lambda self: self.worn == 2 and self.call.made)
    DRILL.to(REST)
    BROKEN.to(REST, when=lambda self: False)


def in_state(name: str) -> Callable[[Any], bool]:
    return lambda v: bool(v.Drill.state == name)


def decided(prop: Property) -> Verdict:
    return explore(Drill, period_ms=100, properties=[prop]).verdicts[0]


def test_what_breaks_can_not_always_be_used_again() -> None:
    """The witness goes the shortest way in, and on to a cycle: one state, as no sensor matters."""
    assert decided(always_possible(in_state("BROKEN"))).holds is True
    verdict = decided(always_possible(in_state("REST")))
    assert verdict.holds is False
    witness = verdict.witness
    assert witness is not None
    assert witness.region is not None
    views = replay(explore(Drill, period_ms=100), witness)
    entered = [view.Drill.state == "BROKEN" for view in views]
    assert entered.index(True) == witness.region.turns
    assert all(entered[witness.region.turns :])
    assert witness.loop is not None
    assert witness.region.states == 2  # before BROKEN's OnEntry, and after


def test_nothing_must_rest_for_ever() -> None:
    """It may be called again and again, never again, or until it breaks."""
    assert decided(eventually_always(in_state("REST"))).holds is False
    assert decided(eventually_always(lambda v: v.Drill.state != "BROKEN")).holds is False
    worn = eventually_always(lambda v: v.Drill.worn == 2, assuming=lambda v: v.Drill.call.made)
    assert decided(worn).holds is True
    verdict = decided(worn._replace(assuming=()))
    assert verdict.holds is False
    assert verdict.witness is not None
    assert verdict.witness.loop is not None


def test_an_execution_must_end_with_what_is_to_hold_for_ever() -> None:
    at_end = eventually_always(lambda v: v.Lift.state == "WORN", assuming=[calling])
    assert verdict_of_lift(at_end).holds is True
    before = eventually_always(lambda v: v.Lift.state != "WORN")
    verdict = verdict_of_lift(before)
    assert verdict.holds is False
    assert verdict.witness is not None
    assert verdict.witness.loop is None


def verdict_of_lift(prop: Property) -> Verdict:
    return explore(Lift, period_ms=100, properties=[prop]).verdicts[0]


# Several responses


def test_responses_come_one_after_the_other() -> None:
    """After a call the bell rings, and then the lift is idle or worn, 500 ms after it waited."""
    idle_or_worn = [ringing, lambda v: v.Lift.state in ("IDLE", "WORN")]
    assert verdict_of_lift(leads_to(waiting, idle_or_worn, assuming=calling)).holds is True
    backwards = leads_to(ringing, [waiting, ringing], assuming=calling)
    assert verdict_of_lift(backwards).holds is False  # it wears


@pytest.mark.parametrize(("within_ms", "holds"), [(599, False), (600, True)])
def test_the_last_of_several_responses_must_be_in_time(within_ms: float, holds: bool) -> None:
    prop = leads_to(
        lambda v: v.Timed.state == "BUSY",
        [lambda v: v.Timed.state == "IDLE", lambda v: v.Timed.state == "BUSY"],
        within_ms=within_ms,
    )
    (verdict,) = explore(Timed, period_ms=100, properties=[prop]).verdicts
    assert verdict.holds is holds


def test_leads_to_needs_a_response() -> None:
    with pytest.raises(PredicateError, match="needs a response"):
        leads_to(waiting, [])
