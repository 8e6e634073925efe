"""Observers see every step, may come and go, and cost nothing when there are none."""

from __future__ import annotations

import sys
from typing import Any

import pytest

from definition import BUILT
from llfsm.runtime import Arrangement, Machine, ManualClock, ObserverError, Reason, State, Trace
from llfsm.runtime.engine import events as ev
from llfsm.runtime.engine.kernel import Kernel
from llfsm.runtime.engine.ringlet import DefinedRotation, defined_ringlet


class Ping(Machine):
    a = State()
    b = State()
    a.to(b)

    @b.to(a)
    def back(self) -> bool:
        return self.is_running("Ping")


def test_a_trace_is_the_list_of_all_events():
    trace = Trace()
    arrangement = Arrangement([Ping], clock=ManualClock(start_ns=5), observers=[trace])
    arrangement.round()
    standing = ev.Standing(0, "Ping", "b", False, None, 5)
    assert trace == [
        ev.RoundBegin(1, 5),
        ev.Turn(1, 5, 0, "Ping", "a", None, None),
        ev.Section(1, 5, "Ping", "a", "OnEntry"),
        ev.Eval(1, 5, "Ping", "a", 0, "true", "b", True),
        ev.Section(1, 5, "Ping", "a", "OnExit"),
        ev.RoundEnd(1, 5, True, False, (standing,)),
    ]
    assert trace.sections() == [(1, "Ping", "OnEntry", "a"), (1, "Ping", "OnExit", "a")]


def test_calls_in_guards_are_not_reported():
    trace = Trace()
    arrangement = Arrangement([Ping], observers=[trace])
    arrangement.round()
    arrangement.round()
    assert not [event for event in trace if isinstance(event, ev.Call)]


def test_attach_and_detach_between_rounds():
    trace, ping = Trace(), Ping()
    arrangement = Arrangement([ping], clock=ManualClock())
    for attach in (False, True, False, True):
        (arrangement.attach if attach else arrangement.detach)(trace)
        arrangement.round()
    assert [event.round for event in trace if isinstance(event, ev.RoundEnd)] == [2, 4]
    assert [(r, state) for r, _, section, state in trace.sections() if section == "OnEntry"] == [
        (2, "b"),
        (4, "b"),
    ]


@pytest.mark.parametrize("section", ["on_entry", "on_exit", "internal"])
def test_attach_and_detach_within_a_section(section: str):
    trace = Trace()

    class Toggler(Machine):
        attached: bool = False
        a = State()
        b = State()
        a.to(b, when=lambda m: section == "on_exit")
        b.to(a)

        def toggle(self) -> None:
            self.attached = not self.attached
            (arrangement.attach if self.attached else arrangement.detach)(trace)

        getattr(a, section)(toggle)

    toggler = Toggler()
    arrangement = Arrangement([toggler, Ping], clock=ManualClock())
    for _ in range(6):
        arrangement.round()
        arrangement.restart("Toggler")
    turns = [event for event in trace if isinstance(event, ev.Turn)]
    assert {event.machine for event in turns} == {"Toggler", "Ping"}
    assert toggler.state_name == ("b" if section == "on_exit" else "a")
    assert not toggler.attached
    before = len(trace)
    assert not arrangement.kernel.observers
    toggler.suspend_self()
    arrangement.round()
    assert len(trace) == before


def test_detaching_what_is_not_attached_does_nothing():
    Arrangement().detach(Trace())


def test_an_observer_may_detach_itself():
    seen = []

    def once(event: ev.Event) -> None:
        seen.append(event)
        arrangement.detach(once)

    trace = Trace()
    arrangement = Arrangement([Ping], observers=[once, trace])
    arrangement.round()
    assert len(seen) == 1
    assert len(trace) == 6


def test_an_observer_that_raises():
    def fragile(event: ev.Event) -> None:
        if isinstance(event, ev.Section):
            raise ZeroDivisionError("observing")

    arrangement = Arrangement([Ping], observers=[fragile])
    with pytest.raises(ObserverError, match=r"fragile.* raised ZeroDivisionError: observing") as e:
        arrangement.run()
    assert isinstance(e.value.__cause__, ZeroDivisionError)
    assert arrangement.reason is Reason.FAILED


def test_a_machine_loaded_while_observed_is_observed():
    trace = Trace()
    arrangement = Arrangement(observers=[trace])
    arrangement.load(Ping)
    arrangement.round()
    assert len(trace.sections()) == 2


def test_without_observers_nothing_stands_between_a_round_and_the_machines_own_functions():
    class Caller(Machine):
        callers: tuple[Any, ...] = ()
        a = State()
        b = State()

        @a.to(b)
        def go(self) -> bool:
            frame = sys._getframe(1)
            callers = []
            while frame.f_code is not Kernel.round.__code__:
                callers.append(frame.f_code)
                frame = frame.f_back
            self.callers = tuple(callers)
            return False

    caller = Caller()
    arrangement = Arrangement([caller])
    trace = Trace()
    arrangement.round()
    defined = defined_ringlet, DefinedRotation.give_turns, DefinedRotation.give_round
    nothing = () if BUILT else tuple(each.__code__ for each in defined)
    assert caller.callers == nothing
    arrangement.attach(trace)
    arrangement.round()
    assert caller.callers != nothing
    arrangement.detach(trace)
    arrangement.round()
    assert caller.callers == nothing


def test_calls_are_reported_with_argument_and_result():
    class Caller(Machine):
        a = State()

        @a.on_entry
        def _(self) -> None:
            self.suspend("Ping")
            self.load(Ping)
            self.suspend_all()
            self.name_of(0)

    trace = Trace()
    Arrangement([Caller, Ping], observers=[trace]).round()
    assert [event[2:] for event in trace if isinstance(event, ev.Call)] == [
        ("Caller", "a", "suspend", "Ping", 0),
        ("Caller", "a", "load", "Ping", 2),
        ("Caller", "a", "suspend_all", None, None),
        ("Caller", "a", "name_of", 0, "Caller"),
    ]
