"""Breakpoints of machines that others call can be set before that."""

from __future__ import annotations

import pytest

from llfsm.runtime import Arrangement, BreakpointError, Machine, ManualClock, Sensor, State
from llfsm.runtime.debugging import Debugger
from llfsm.runtime.engine.submachine import Submachine
from llfsm.whiteboard import Slot, Whiteboard
from llfsm.whiteboard.messages.std_msgs import Int32
from waiting import PATIENCE_S

from .machines import running

PLACE = Slot("place", Int32)


class Child(Machine):
    """Be called."""

    place = Sensor(PLACE)

    begun = State()
    over = State()
    begun.to(over, after_ms=20)


class Parent(Machine):
    """Call it, in its third turn."""

    turns: int = 0
    child: Submachine[Child] | None = None

    waits = State()
    calls = State()
    over = State()

    @waits.internal
    def _(self) -> None:
        self.turns += 1

    @waits.to(calls)
    def is_third(self) -> bool:
        return self.turns == 3

    @calls.on_entry
    def _(self) -> None:
        self.child = self.call_machine(Child)

    @calls.to(over)
    def is_done(self) -> bool:
        return self.child is not None and self.child.done


def test_of_a_class_beside_the_one_that_calls_it() -> None:
    board = Whiteboard.local()
    board.add_message(PLACE, Int32(data=7))
    arrangement = Arrangement([Parent], clock=ManualClock(), whiteboard=board)
    with running(arrangement) as debugger:
        debugger.break_at("Child:over", "@place if data == 7")
        debugger.proceed()
        assert debugger.wait(PATIENCE_S) == "breakpoint @place if data == 7"
        assert debugger.machine == "Child"
        debugger.proceed()
        assert debugger.wait(PATIENCE_S) == "breakpoint Child:over"
        debugger.proceed()
    for text in ("Child:missing", "Chld:over", "@plce"):
        with pytest.raises(BreakpointError):
            debugger.break_at(text)


def test_of_one_that_has_run() -> None:
    called = define_child()
    arrangement = Arrangement([Parent], clock=ManualClock(), whiteboard=Whiteboard.local())
    with running(arrangement) as debugger:
        with pytest.raises(BreakpointError, match="no machine 'Elsewhere'"):
            debugger.break_at("Elsewhere:over")
        arrangement.load(called)
        arrangement.unload("Elsewhere")
        debugger.break_at("Elsewhere:over")


def define_child() -> type[Machine]:
    """Return a machine that no module has."""

    class Elsewhere(Machine):
        begun = State()
        over = State()
        begun.to(over)

    return Elsewhere


def test_a_machine_without_others_has_none() -> None:
    with pytest.raises(BreakpointError, match="no machine 'Machine'; there are: Child"):
        Debugger(Arrangement([Child], whiteboard=Whiteboard.local())).break_at("Machine:over")
