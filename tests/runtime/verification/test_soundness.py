"""What would make a verdict wrong: each is explored as it is, or refused by name."""

from __future__ import annotations

import enum
import sys
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated, Any

import msgspec
import pytest

from llfsm.runtime import Actuator, Machine, Sensor, State, define
from llfsm.runtime.verification import (
    NO_FAILURE,
    DomainError,
    Property,
    UnsupportedError,
    every,
    explore,
    leads_to,
    monitor,
    never,
    reachable,
)
from llfsm.whiteboard import Message, Slot


class Switch(Message):
    on: bool = False


class Level(Message):
    value: Annotated[int, msgspec.Meta(ge=0, le=999)] = 0


SWITCH, LAMP = Slot("switch", Switch), Slot("lamp", Switch)


def holds(machines: Any, prop: Property, **how: Any) -> bool | None:
    """Return the verdict of one property."""
    (verdict,) = explore(machines, period_ms=10, properties=[prop], **how).verdicts
    return verdict.holds


def runs(code: Callable[[Any], Any], name: str = "M", **attributes: Any) -> type[Machine]:
    """Return a machine that runs `code` in each turn, and stays."""
    start = State("START")
    start.internal(code)
    start.to(start, when=lambda self: False)
    return define(name, [start], attributes=attributes, variables={"n": (Any, 0)})


def test_the_time_that_is_asked_for_in_on_suspend_is_that_of_the_state_that_is_left() -> None:
    class Patient(Machine):
        late: bool = False
        WAIT, REST = State(), State(suspend=True)
        WAIT.to(WAIT, when=lambda self: False)

        @WAIT.on_suspend
        def _(self) -> None:
            self.late = self.after_ms(50)

    class Nurse(Machine):
        A, B = State(), State()
        A.to(B, after_ms=80)
        B.on_entry(lambda self: self.suspend("Patient"))
        B.to(A, when=lambda self: False)

    assert holds([Patient, Nurse], reachable(lambda v: v.Patient.late))


@pytest.mark.parametrize("leaves_if", [True, False])
@pytest.mark.parametrize("verb", ["suspend_all", "unload"])
def test_who_is_loaded_is_known_wherever_it_matters(leaves_if: bool, verb: str) -> None:
    """In the same turn, one machine has left in some states and not in others."""

    class Leaver(Machine):
        switch = Sensor(SWITCH, default=Switch(), domain=every(Switch))
        HERE, GONE, HELD = State(), State(), State(suspend=True)
        HERE.to(GONE, when=lambda self: self.switch.on is leaves_if)

    class Caller(Machine):
        A, B, C = State(), State(), State()
        A.to(B)
        B.to(C)
        C.to(A, when=lambda self: False)

        @B.on_exit
        def _(self) -> None:
            if verb == "suspend_all":
                self.suspend_all()
            else:
                self.unload("Leaver")

    machines = [Leaver, Caller]
    there = verb == "unload"
    suspended = reachable(lambda v: v.Leaver.suspended)
    assert holds(machines, suspended) is not there
    assert holds(machines, NO_FAILURE) is not there  # what has left cannot be unloaded


def test_to_ask_for_a_machine_that_has_left_fails() -> None:
    gone = define("Gone", [State("END")])
    for code in (
        lambda self: self.is_suspended("Gone"),
        lambda self: self.suspend("Gone"),
        lambda self: self.index_of("Gone"),
        lambda self: self.name_of(0),
    ):
        assert holds([gone, runs(code)], NO_FAILURE) is False


def test_errors_list_machines_in_their_order_whoever_has_left_before() -> None:
    """Else the same would not be done again."""

    class Leaver(Machine):
        switch = Sensor(SWITCH, default=Switch(), domain=every(Switch))
        HERE, GONE = State(), State()
        HERE.to(GONE, when=lambda self: self.switch.on)

    def asks(self: Any) -> None:
        if self.switch.on:
            self.index_of("Gone")

    switch = Sensor(SWITCH, default=Switch())
    machines = [define("Gone", [State("END")]), Leaver, runs(asks, switch=switch)]
    assert explore(machines, period_ms=10).complete


class Watch(Machine):
    lamp = Sensor(LAMP, default=Switch())
    DARK, BRIGHT = State(), State()
    DARK.to(BRIGHT, when=lambda self: self.lamp.on)


@pytest.mark.parametrize(
    "code",
    [
        lambda self: self.suspend_all(),
        lambda self: setattr(self, "n", self.number_of_machines),
        lambda self: self.suspend("Watch"),
        lambda self: setattr(self, "n", self.is_suspended("Watch")),
    ],
)
def test_a_monitor_is_not_there_for_the_others(code: Callable[[Any], Any]) -> None:
    with pytest.raises(UnsupportedError, match="reaches the monitor Watch"):
        holds(runs(code, lamp=Actuator(LAMP)), monitor(Watch, Watch.BRIGHT))


def test_a_monitor_asks_for_nothing_to_be_done() -> None:
    class Nosy(Watch):
        @Watch.DARK.internal
        def _(self) -> None:
            self.suspend("M")

    with pytest.raises(UnsupportedError, match="Nosy asks to suspend M: a monitor must not act"):
        holds(runs(lambda self: None, lamp=Actuator(LAMP)), monitor(Nosy, Nosy.BRIGHT))


def test_whether_a_machine_will_be_resumed_is_not_known_where_anybody_may_restart_it() -> None:
    """A restart that was asked for before would not be undone: that is seen in the status."""
    other = runs(lambda self: None, "Other")
    asks = runs(lambda self: setattr(self, "n", self.resume("Other") < 0))
    assert explore([asks, other], period_ms=10).complete
    with pytest.raises(UnsupportedError, match=r"status that resume\('Other'\) returned"):
        explore([asks, other], period_ms=10, suspend=["Other"])
    careless = runs(lambda self: self.resume("Other"))
    assert explore([careless, other], period_ms=10, suspend=["Other"]).complete


def cached(self: Any) -> int:
    return int(self.n)


class Slotted(Machine):
    __slots__ = ("hidden",)
    A = State()


class Hiding(Slotted):
    pass


@pytest.mark.parametrize(
    ("machine", "message"),
    [
        (runs(lambda self: None, f=lru_cache(cached)), "M.f keeps results"),
        (Hiding, "Hiding.hidden is in __slots__"),
        (define("M", [State("Suspended")]), "M has a state 'Suspended'"),
        (runs(lambda self: setattr(self, "stopping", True)), "M assigns to its 'stopping'"),
        (
            runs(lambda self: setattr(self, "lamp", print), lamp=Actuator(LAMP)),
            "M assigns to its 'lamp'",
        ),
        (
            runs(
                lambda self: None,
                a=Sensor(SWITCH, domain=every(Switch)),
                b=Sensor(SWITCH),
            ),
            "M reads 'switch' by a and b",
        ),
    ],
)
def test_what_hides_from_a_state_is_refused(machine: type[Machine], message: str) -> None:
    with pytest.raises(UnsupportedError, match=message):
        explore(machine, period_ms=10)


def test_too_many_choices_are_refused_before_they_fill_the_memory() -> None:
    slots = [Slot(f"level/{number}", Level) for number in range(4)]
    one = runs(lambda self: None, **{f"s{n}": Sensor(each) for n, each in enumerate(slots[:2])})
    two = runs(lambda self: None, "N", **{f"s{n}": Sensor(s) for n, s in enumerate(slots[2:])})
    few, domain = every(Level)[:300], every(Level)
    with pytest.raises(DomainError, match="for M there are 1,000,000 combinations"):
        explore(one, period_ms=10, sensors=dict.fromkeys(slots[:2], domain))
    how: dict[str, Any] = {"period_ms": 10, "sensors": dict.fromkeys(slots, few[:20])}
    with pytest.raises(DomainError, match="for the environment there are 160,000"):
        explore([one, two], choices="rounds", **how)


def exits(*_: Any) -> bool:
    sys.exit(0)


def test_code_that_exits_has_failed() -> None:
    assert holds(runs(exits), NO_FAILURE) is False
    with pytest.raises(Exception, match="SystemExit"):
        holds(runs(lambda self: None), never(exits))


def test_an_interruption_in_code_ends_the_exploration() -> None:
    def interrupted(self: Any) -> None:
        raise KeyboardInterrupt

    space = explore(runs(interrupted), period_ms=10, properties=[NO_FAILURE])
    assert (space.complete, space.verdicts[0].holds) == (False, None)


class Kinds(enum.IntFlag):
    ONE = 1


@dataclass
class Box:
    value: int = 0


def box_with_more() -> Box:
    box = Box()
    box.other = 1  # type: ignore[attr-defined]
    return box


def test_values_that_are_hardly_different_are() -> None:
    values = [Kinds(0), Kinds(4), Kinds(8), deque([1]), deque([1], 2), Box(0), Box(1)]

    def code(self: Any) -> None:
        self.i = min(getattr(self, "i", -1) + 1, len(values) - 1)
        self.n = values[self.i]

    assert explore(runs(code), period_ms=10).values["M.n"] == len(values) + 1


def test_values_of_which_not_all_is_known_are_refused() -> None:
    endless: list[Any] = []
    endless.append(endless)
    for value, message in ((box_with_more(), "a Box with 'other'"), (endless, "without end")):
        with pytest.raises(UnsupportedError, match=message):
            explore(runs(lambda self, value=value: setattr(self, "n", value)), period_ms=10)


def test_a_property_is_asked_of_states_alone() -> None:
    """What it divides by is 0 at first, but not in the state of which it asks."""

    class Divisor(Machine):
        number: int = 0
        A, B = State(), State()
        A.on_exit(lambda self: setattr(self, "number", 5))
        A.to(B)
        B.to(A, when=lambda self: False)

    assert holds(Divisor, never(lambda v: v.Divisor.state == "B" and 10 / v.Divisor.number > 2))


def test_a_time_of_a_period_is_as_long_as_a_period() -> None:
    """As a floating-point product, this one is not quite as many nanoseconds."""
    begin, done = State("BEGIN"), State("DONE")
    begin.to(done)
    done.to(begin, when=lambda self: False)
    machine, ms = define("M", [begin, done]), 2.01
    assert int(ms * 1e6) < round(ms * 1e6)
    prop = leads_to(lambda v: v.M.state == "BEGIN", lambda v: v.M.state == "DONE", within_ms=ms)
    assert explore(machine, period_ms=ms, properties=[prop]).verdicts[0].holds
