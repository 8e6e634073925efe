"""Requests from outside: what they do on an arrangement that runs was explored."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import HealthCheck, example, given, settings

from containment import Boundary, Happenings, assert_contained, happenings
from llfsm.runtime import Arrangement, Machine, ManualClock, State, define
from llfsm.runtime.counterexamples import replay
from llfsm.runtime.engine.events import Event, Reason, RoundEnd, Turn
from llfsm.runtime.verification import explore, leads_to, reachable
from thoroughness import examples


class Sleeper(Machine):
    """Note in its sleep that a stop has come, and stay awake after that."""

    noted: bool = False
    AWAKE, END, ASLEEP = State(), State(), State(suspend=True)
    AWAKE.to(END, when=lambda self: self.stopping and not self.noted)

    @ASLEEP.internal
    def _(self) -> None:
        self.noted = self.stopping


def test_who_is_suspended_when_a_stop_comes_may_still_be_resumed() -> None:
    """It may also end without that, and then there is no response."""
    late = reachable(lambda v: v.Sleeper.noted and v.Sleeper.state == "AWAKE", "late")
    wakes = leads_to(lambda v: v.Sleeper.noted, lambda v: v.Sleeper.state == "AWAKE", "wakes")
    soon = wakes._replace(within_ms=1000, name="wakes soon")
    how: Any = {"period_ms": 10, "stop": True, "suspend": "Sleeper"}
    space = explore(Sleeper, properties=[late, wakes, soon], **how)
    assert [verdict.holds for verdict in space.verdicts] == [True, False, False]
    first, *ends = [verdict.witness for verdict in space.verdicts]
    assert first is not None
    before, after = replay(space, first)[-2:]
    assert before.Sleeper.noted
    assert after.Sleeper.state == "AWAKE"
    for each in ends:
        assert each is not None
        assert (each.loop, len(each.turns)) == (None, len(first.turns) - 1)


def test_a_restart_that_is_pending_may_be_withdrawn() -> None:
    """By a suspend, which a resume replaces: so the machine accepts after one turn."""
    start = State("START")
    start.on_entry(lambda self: self.restart_self())
    machine = define("Again", [start])
    left = reachable(lambda v: not v.Again.loaded, "left")
    space = explore(machine, period_ms=10, suspend="Again", properties=[left])
    (verdict,) = space.verdicts
    assert verdict.witness is not None
    assert not replay(space, verdict.witness)[-1].Again.loaded
    alone = explore(machine, period_ms=10, properties=[left])
    assert not alone.verdicts[0].holds


def test_a_run_ends_after_a_stop_unless_a_resume_is_there() -> None:
    """So it is explored: a request is obeyed after a round, and before that is the last."""
    for wakes in (True, False):
        arrangement = Arrangement([Sleeper], clock=ManualClock())

        def ask(event: Event, arrangement: Arrangement = arrangement, wakes: bool = wakes) -> None:
            if isinstance(event, Turn) and event.round == 2:
                arrangement.control.hold("Sleeper")
            elif isinstance(event, Turn) and event.round == 4:
                arrangement.stop()  # which is seen in the next round
            elif isinstance(event, RoundEnd) and event.round == 5 and wakes:
                arrangement.resume("Sleeper")

        arrangement.attach(ask)
        reason = arrangement.run(max_rounds=6)
        rounds, state = arrangement.rounds, arrangement.state_name_of("Sleeper")
        seen = reason, rounds, state
        assert seen == (
            (Reason.MAX_ROUNDS, 6, "AWAKE") if wakes else (Reason.ACCEPTING, 5, "ASLEEP")
        )


_ASLEEP_AND_WAKING: Any = [[({"on_suspend": [("resume", "A")]}, [(0, None, None)])]]
_SUSPENDED = Boundary(asked=("suspend",))
_STOPPED = Boundary(asked=("suspend", "stop"))  # at the end of the same round
_WITHDRAWN = Happenings(
    _ASLEEP_AND_WAKING, False, 5, [Boundary(), Boundary(), _SUSPENDED, _STOPPED]
)


@pytest.mark.filterwarnings("ignore::llfsm.runtime.UnreachableStateWarning")
@settings(max_examples=examples(5), suppress_health_check=list(HealthCheck), deadline=None)
@given(happenings)
@example(_WITHDRAWN)
def test_requests_at_any_boundary_lead_to_explored_states(happened: Happenings) -> None:
    """`make soak` runs more of them."""
    assert_contained(happened, most=100)
