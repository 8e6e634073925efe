"""Machines that go on in place after a suspension, with the time that they had in their state."""

from __future__ import annotations

from typing import Any

import pytest

from llfsm.runtime import Machine, State
from llfsm.runtime.counterexamples import replay
from llfsm.runtime.verification import (
    PropertyError,
    Space,
    UnsupportedError,
    always,
    explore,
    never,
    verify,
)


def doses(clock: Any) -> type[Machine]:
    class Doses(Machine):
        """Gives a dose for 50 ms."""

        given: int = 0
        turns: int = 0
        dose = State(resume="in_place", clock=clock)
        over = State()
        dose.to(over, after_ms=45)

        @dose.on_entry
        def _(self) -> None:
            self.given = min(self.given + 1, 2)

        @dose.internal
        def _(self) -> None:
            self.turns = min(self.turns + 1, 5)

    return Doses


HOW: dict[str, Any] = {"period_ms": 10, "suspend": ["Doses"]}


def is_short(view: Any) -> bool:
    return bool(view.Doses.state == "over" and view.Doses.turns < 5)


def test_nothing_is_done_twice_and_a_clock_that_stops_leaves_out_the_suspension() -> None:
    once = never(lambda v: v.Doses.given > 1)
    asked = [once, never(is_short)]
    found = explore(doses("stops"), properties=asked, **HOW)
    once_only, never_short = (verdict.holds for verdict in found.verdicts)
    assert never_short
    assert not once_only  # after a restart
    found = explore(doses("runs"), properties=[never(is_short)], **HOW)
    assert found.verdicts[0].holds is False
    assert is_short(ends(found)[-1])


def ends(space: Space) -> list[Any]:
    """Run the counterexample again on machines that really run."""
    witness = space.verdicts[0].witness
    assert witness is not None
    return replay(space, witness)


def test_of_any_time_only_states_without_a_limit_are_explored() -> None:
    class Waits(Machine):
        entered: int = 0
        go = State(resume="in_place", final=False)

        @go.on_entry
        def _(self) -> None:
            self.entered = min(self.entered + 1, 2)

    class Suspends(Machine):
        turns: int = 0
        go, back, over = State(), State(), State()
        go.to(back, when=lambda self: self.is_running("Waits"))
        back.to(over, when=lambda self: self.is_running("Waits"))

        @go.on_entry
        def _(self) -> None:
            self.suspend("Waits")

        @back.on_entry
        def _(self) -> None:
            self.resume("Waits")

    verify([Waits, Suspends], never(lambda v: v.Waits.entered > 1))
    with pytest.raises(PropertyError):
        verify([Waits], never(lambda v: v.Waits.entered > 1), suspend="Waits")  # by a restart
    with pytest.raises(UnsupportedError, match=r"suspended in dose, .* give period_ms"):
        explore(doses("runs"), suspend="Doses")


def test_a_turn_that_would_ask_for_two_times_is_refused() -> None:
    class Asks(Machine):
        late: bool = False
        go = State(resume="in_place")
        over = State()
        asleep = State(suspend=True)
        go.to(over, after_ms=50)

        @go.on_resume
        def _(self) -> None:
            self.late = self.after_ms(20)

    with pytest.raises(UnsupportedError, match="Asks asks for the time in OnResume, and goes on"):
        verify(Asks, always(lambda v: True), period_ms=10, suspend="Asks")
