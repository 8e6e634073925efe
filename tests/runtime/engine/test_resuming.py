"""A machine that is resumed enters its state again, or goes on in place."""

from __future__ import annotations

from typing import Any

import pytest

from definition import Defined
from llfsm.runtime import Arrangement, DefinitionError, Machine, ManualClock, State


class Doses(Machine):
    """Gives a dose when it enters a state, and waits for 100 ms."""

    given: int = 0
    resumed: int = 0
    bad: bool = False
    dose = State(resume="in_place", clock="stops")
    over = State(final=False)

    @dose.on_entry
    def _(self) -> None:
        if self.bad:
            self.bad = False
            raise ValueError("on purpose")
        self.given += 1

    @dose.on_resume
    def _(self) -> None:
        self.resumed += 1

    dose.to(over, after_ms=100)


class Runs(Doses):
    """The same, but its clock runs on."""

    first = State(resume="in_place")

    @first.on_entry
    def _(self) -> None:
        self.given += 1

    Doses.dose.to(first)
    first.to(Doses.over, after_ms=100)


def world(kind: type[Arrangement], machine: Machine, **how: Any) -> tuple[Arrangement, ManualClock]:
    clock = ManualClock()
    return kind([machine], clock=clock, **how), clock


def pass_ms(arrangement: Arrangement, clock: ManualClock, ms: int) -> str:
    clock.advance(ms=ms)
    arrangement.round()
    return str(next(iter(arrangement.states().values())))


@pytest.mark.parametrize("kind", [Arrangement, Defined])
def test_a_dose_is_not_given_twice(kind: type[Arrangement]) -> None:
    doses = Doses()
    arrangement, clock = world(kind, doses)
    sections: list[str] = []
    arrangement.round()
    assert pass_ms(arrangement, clock, 60) == "dose"
    arrangement.suspend("Doses")
    assert pass_ms(arrangement, clock, 0) == "Suspended"
    assert pass_ms(arrangement, clock, 1000) == "Suspended"
    arrangement.attach(lambda event: sections.append(getattr(event, "section", "")))
    arrangement.resume("Doses")
    assert pass_ms(arrangement, clock, 0) == "dose"
    assert (doses.given, doses.resumed) == (1, 1)
    assert [each for each in sections if each] == ["OnResume", "Internal"]
    assert pass_ms(arrangement, clock, 40) == "dose"  # 100 ms, without those of the suspension
    assert pass_ms(arrangement, clock, 1) == "over"


def test_the_clock_runs_on_unless_it_stops() -> None:
    doses = Runs()
    arrangement, clock = world(Arrangement, doses)
    assert pass_ms(arrangement, clock, 0) == "first"
    arrangement.round()
    arrangement.suspend("Runs")
    pass_ms(arrangement, clock, 60)
    arrangement.resume("Runs")
    assert pass_ms(arrangement, clock, 41) == "over"


@pytest.mark.parametrize("how", ["restart", "failure", "not entered"])
def test_otherwise_it_is_entered(how: str) -> None:
    doses = Doses(bad=how == "failure")
    arrangement, clock = world(Arrangement, doses, on_error="suspend")
    if how == "not entered":
        arrangement.suspend("Doses")
    arrangement.round()
    if how == "restart":
        arrangement.suspend("Doses")
        arrangement.round()
        arrangement.restart("Doses")
        arrangement.round()
        assert doses.given == 2
        return
    arrangement.round()
    arrangement.resume("Doses")
    assert pass_ms(arrangement, clock, 0) == "dose"
    assert doses.given == 1


def test_a_transition_to_it_is_no_resumption() -> None:
    class Back(Doses):
        Doses.over.to(Doses.dose)

    back = Back()
    arrangement, clock = world(Arrangement, back)
    arrangement.round()
    arrangement.suspend("Back")
    arrangement.round()
    arrangement.resume("Back")
    arrangement.round()
    assert pass_ms(arrangement, clock, 101) == "over"
    arrangement.round()
    arrangement.round()
    assert back.given == 2


def test_what_it_runs_goes_on_in_place_too() -> None:
    class Outer(Machine):
        entered: int = 0
        work = State(runs=Doses, resume="in_place")
        work.to(work, when=lambda self: False)

        @work.on_entry
        def _(self) -> None:
            self.entered += 1

    outer = Outer()
    arrangement, clock = world(Arrangement, outer)
    arrangement.round()
    arrangement.suspend("Outer")
    arrangement.round()
    arrangement.resume("Outer")
    arrangement.round()
    assert outer.entered == 1
    assert outer.work.machine.given == 1
    assert arrangement.states() == {"Outer": "work", "Outer/Doses": "dose"}
    assert clock.now_ns() == 0


@pytest.mark.parametrize(
    "wrong",
    [{"resume": "there"}, {"clock": "slow"}, {"clock": "stops"}],
)
def test_what_makes_no_sense_is_refused(wrong: Any) -> None:
    with pytest.raises(DefinitionError, match=r"must be|is for resume"):
        State("a", **wrong)


@pytest.mark.parametrize("kind", [Arrangement, Defined])
def test_a_transition_of_the_suspend_state_is_no_resumption(kind: type[Arrangement]) -> None:
    class Wakes(Machine):
        entered: int = 0
        work = State(final=False)
        next_one = State(resume="in_place", final=False)
        asleep = State(suspend=True)
        asleep.to(next_one, after_ms=10)

        @next_one.on_entry
        def _(self) -> None:
            self.entered += 1

    wakes = Wakes()
    arrangement, clock = world(kind, wakes)
    arrangement.round()
    arrangement.suspend("Wakes")
    arrangement.round()
    assert pass_ms(arrangement, clock, 11) == "next_one"
    arrangement.round()
    assert wakes.entered == 1
