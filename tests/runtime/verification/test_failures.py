"""What follows code that raises: the end of all, of which nothing is claimed, or a suspension."""

from __future__ import annotations

from typing import Any

import pytest

from llfsm.runtime import Actuator, Machine, OptionError, Sensor, State
from llfsm.runtime.verification import (
    NO_FAILURE,
    Property,
    PropertyError,
    every,
    explore,
    leads_to,
    monitor,
    never,
    reachable,
    step,
    verify,
)
from llfsm.whiteboard import Message, Slot


class Bit(Message):
    on: bool = False


IN, MOTOR, ALARM = Slot("in", Bit), Slot("motor", Bit), Slot("alarm", Bit)


class Faulty(Machine):
    """It fails when it sees the bit, also while it is suspended."""

    seen = Sensor(IN, default=Bit(), domain=every(Bit))
    motor = Actuator(MOTOR, at_failure=Bit(on=True), at_end=Bit(on=False))
    A, B, REST = State(), State(), State(suspend=True)
    A.to(B, when=lambda self: self.seen.on and 1 // 0 > 0)
    B.to(A)
    REST.to(REST, when=lambda self: self.seen.on and 1 // 0 > 0)


class Watch(Machine):
    alarm = Actuator(ALARM)
    OK, LOST = State(), State()
    OK.to(LOST, when=lambda self: self.is_suspended("Faulty"))
    LOST.on_entry(lambda self: self.alarm(Bit(on=True)))
    LOST.to(OK, when=lambda self: False)


def holds(prop: Property, machines: Any = (Faulty, Watch), **how: Any) -> bool | None:
    """Return the verdict of one property."""
    return explore(machines, period_ms=10, properties=[prop], **how).verdicts[0].holds


never_alarm = never(lambda v: v[ALARM].on, "no alarm")
never_motor = never(lambda v: v[MOTOR].on, "motor off")


def test_a_machine_that_fails_is_suspended_and_the_others_go_on() -> None:
    assert holds(NO_FAILURE, on_error="suspend") is False
    assert holds(never_alarm, on_error="suspend") is False
    assert holds(never_motor, on_error="suspend") is False  # its value for a failure is posted
    failed = never(lambda v: v.Faulty.has_failed and not v.Faulty.suspended)
    assert holds(failed, on_error="suspend") is True
    assert holds(never(lambda v: v.Watch.has_failed), on_error="suspend") is True


def test_who_failed_and_who_was_asked_to_wait_are_told_apart() -> None:
    class Held(Machine):
        seen = Sensor(IN, default=Bit(), domain=every(Bit))
        A = State()
        A.to(A, when=lambda self: self.seen.on and 1 // 0 > 0)

    class Asker(Machine):
        seen = Sensor(IN, default=Bit(), domain=every(Bit))
        B, C = State(), State()
        B.to(C, when=lambda self: self.seen.on)
        C.on_entry(lambda self: self.suspend("Held"))
        C.to(B, when=lambda self: False)

    waits = step(
        lambda before, after: (
            not (before.Held.suspended and after.Held.suspended)
            or before.Held.has_failed == after.Held.has_failed
        )
    )
    assert holds(waits, (Held, Asker), on_error="suspend") is True
    for failed in (False, True):
        stays = reachable(lambda v, f=failed: v.Held.suspended and v.Held.has_failed is f)
        assert holds(stays, (Held, Asker), on_error="suspend") is True


def test_one_that_fails_while_it_is_suspended_is_unloaded() -> None:
    class Alone(Faulty):
        pass

    for prop in (
        reachable(lambda v: not v.Alone.loaded and v.Alone.has_failed and not v[MOTOR].on),
        leads_to(lambda v: v.Alone.has_failed, lambda v: v.Alone.suspended),
    ):
        assert holds(prop, Alone, on_error="suspend")


def test_one_that_is_resumed_has_not_failed_any_more() -> None:
    resumed = reachable(lambda v: v[MOTOR].on and not v.Faulty.has_failed)
    assert holds(resumed, on_error="suspend") is False
    assert holds(resumed, on_error="suspend", suspend=["Faulty"]) is True


@pytest.mark.parametrize(
    ("prop", "verdict"),
    [
        (NO_FAILURE, False),
        (never_alarm, None),
        (reachable(lambda v: v.Watch.state == "LOST"), None),
        (leads_to(lambda v: v.Faulty.seen.on, lambda v: v.Faulty.state == "A"), None),
        (reachable(lambda v: v.Faulty.seen.on), True),
        (never(lambda v: v.Faulty.seen.on), False),
    ],
)
def test_where_all_ends_with_a_failure_only_what_some_way_shows_is_known(
    prop: Property, verdict: bool | None
) -> None:
    assert holds(prop) is verdict


def test_an_error_says_why_something_is_undecided() -> None:
    with pytest.raises(PropertyError, match="no alarm: undecided, as code raises"):
        verify([Faulty, Watch], never_alarm, period_ms=10)


def test_a_monitor_that_fails_ends_the_exploration() -> None:
    """Were it suspended, it would see nothing more, and its property would hold."""

    class Nosy(Machine):
        motor = Sensor(MOTOR, default=Bit())
        GOOD, ODD, BAD = State(), State(), State()
        GOOD.to(ODD, when=lambda self: self.motor.on and 1 // 0 > 0)
        GOOD.to(BAD, when=lambda self: False)

    assert holds(monitor(Nosy, Nosy.BAD), on_error="suspend") is None


def test_on_error_is_one_of_two() -> None:
    with pytest.raises(OptionError, match="on_error is 'ignore'"):
        explore(Watch, any_time=True, on_error="ignore")  # type: ignore[arg-type]
