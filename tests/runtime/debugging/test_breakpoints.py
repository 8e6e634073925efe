"""Machines are paused where breakpoints say, and cost nothing where there are none."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from llfsm.runtime import Actuator, Arrangement, BreakpointError, Machine, ManualClock, State
from llfsm.runtime.debugging import Debugger
from llfsm.runtime.presence.remote import Directory
from llfsm.whiteboard import Whiteboard
from llfsm.whiteboard.messages.llfsm import MachineRequest, status_slot
from llfsm.whiteboard.messages.std_msgs import Int32
from waiting import PATIENCE_S, wait_for

from .machines import POSE, Counter, Driver, running, stopped_at


class Fails(Machine):
    """Fail in its third turn."""

    turns: int = 0

    fine = State()
    fine.to(fine, when=lambda m: False)

    @fine.internal
    def _(self) -> None:
        self.turns += 1
        if self.turns == 3:
            raise ValueError("the third")


def first_pause(
    breakpoint: str,
    machines: list[type[Machine]],
    look: Callable[[Debugger, Arrangement], Any],
    **how: Any,
) -> Any:
    """Run to the first pause at a breakpoint, and return what `look` returns there."""
    arrangement = Arrangement(machines, whiteboard=Whiteboard.local(), clock=ManualClock(), **how)
    arrangement.whiteboard.add_message(POSE, Int32(data=3))
    with running(arrangement) as debugger:
        debugger.break_at(breakpoint)
        debugger.proceed()
        debugger.wait(PATIENCE_S)
        return look(debugger, arrangement)


def where(debugger: Debugger, arrangement: Arrangement) -> tuple[str, str, int]:
    counter = arrangement.machine("Counter")
    return debugger.paused, arrangement.state_name_of("Counter"), counter.turns


@pytest.mark.parametrize(
    ("text", "state", "turns"),
    [
        ("Counter:high", "high", 3),
        ("Counter:high#2", "high", 9),
        ("Counter:high if turns > 3", "high", 9),
        ("Counter:high if self.turns > 3 and 2 * turns < 1000", "high", 9),
        ("Counter:low->", "high", 3),
        ("Counter:high->", "low", 6),
        ("Counter:high->low#2", "low", 12),
    ],
)
def test_a_state_is_entered_or_left(text: str, state: str, turns: int) -> None:
    """The pause comes after the transition, and before OnEntry."""
    found = first_pause(text, [Counter], where)
    assert found == (f"breakpoint {text}", state, turns)


def test_a_step_into_the_state_is_no_second_entry() -> None:
    def look(debugger: Debugger, arrangement: Arrangement) -> list[str]:
        found = []
        for _ in range(4):
            stopped_at(debugger)
            found.append(f"{debugger.paused} {arrangement.state_name_of('Counter')}")
        return found

    found = first_pause("Counter:high", [Counter], look)
    assert found == ["step: turn high"] * 2 + ["step: turn low"] * 2


def test_the_first_state_is_entered_in_the_first_turn() -> None:
    arrangement = Arrangement([Counter, Driver], whiteboard=Whiteboard.local(), clock=ManualClock())
    Debugger(arrangement).break_at("Counter:low")
    with running(arrangement) as debugger:  # which pauses before that turn
        debugger.proceed()
        debugger.wait(PATIENCE_S)
        assert debugger.turn is not None
        assert (debugger.turn.round, debugger.turn.machine) == (1, "Driver")


def test_a_state_is_entered_by_a_request() -> None:
    arrangement = Arrangement([Counter], clock=ManualClock())
    with running(arrangement) as debugger:
        debugger.break_at("Counter:Suspended")
        arrangement.control.hold("Counter")
        debugger.proceed()
        assert debugger.wait(PATIENCE_S) == "breakpoint Counter:Suspended"
        arrangement.resume("Counter")


def test_a_machine_has_a_message() -> None:
    def look(debugger: Debugger, arrangement: Arrangement) -> int:
        debugger.break_at("@pose if data > 5")
        debugger.proceed()
        arrangement.whiteboard.add_message(POSE, Int32(data=4))
        arrangement.whiteboard.add_message(POSE, Int32(data=7))
        assert debugger.wait(PATIENCE_S) == "breakpoint @pose if data > 5"
        return arrangement.machine("Driver").pose.data

    assert first_pause("@pose", [Driver], look) == 7


@pytest.mark.parametrize("on_error", ["suspend", "stop"])
@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_code_of_a_machine_raises(on_error: Any) -> None:
    def look(debugger: Debugger, arrangement: Arrangement) -> tuple[bool, bool]:
        assert debugger.paused.startswith("breakpoint Fails!")
        return arrangement.roster.find("Fails").failure is not None, arrangement.reason is None

    assert first_pause("Fails!", [Fails, Counter], look, on_error=on_error) == (True, True)


def test_what_had_been_seen_as_the_transition_fired() -> None:
    def look(debugger: Debugger, _: Arrangement) -> Any:
        fired = debugger.fired
        assert fired is not None
        return fired[:3], [(cause.value, cause.seen) for cause in fired.causes]

    found = first_pause("Driver:waiting if pose.data == 30", [Feeder, Driver], look)
    assert found == (
        ("Driver", "going", "waiting"),
        [(True, "pose.data=30 > limit=9"), (None, "not evaluated")],
    )


class Feeder(Machine):
    """Post what makes a Driver wait."""

    pose = Actuator(POSE)

    one = State()
    one.to(one, when=lambda m: False)

    @one.internal
    def _(self) -> None:
        self.pose(Int32(data=30))


def test_a_condition_that_cannot_be_evaluated_pauses_and_says_so() -> None:
    found = first_pause("Counter:high if tuns > 3", [Counter], where)
    assert "its condition cannot be evaluated: no name 'tuns'" in found[0]
    found = first_pause("Counter:high if turns / 0", [Counter], where)
    assert "its condition cannot be evaluated: ZeroDivisionError" in found[0]


def test_all_that_are_reached_in_a_turn_are_named() -> None:
    arrangement = Arrangement([Counter], clock=ManualClock())
    with running(arrangement) as debugger:
        debugger.break_at("Counter:high", "Counter:low->high if turns > 0", "Counter:high->")
        debugger.proceed()
        found = debugger.wait(PATIENCE_S)
        assert found == "breakpoint Counter:high; breakpoint Counter:low->high if turns > 0"
        debugger.proceed()
        assert debugger.wait(PATIENCE_S) == "breakpoint Counter:high->"


def test_one_that_stays_goes_on_counting_its_hits() -> None:
    arrangement = Arrangement([Counter], clock=ManualClock())
    with running(arrangement) as debugger:
        debugger.break_at("Counter:high#2", "Counter:high")
        debugger.proceed()
        assert debugger.wait(PATIENCE_S) == "breakpoint Counter:high"
        debugger.break_at("Counter:low->high#9", "Counter:high#2")
        debugger.proceed()
        assert debugger.wait(PATIENCE_S) == "breakpoint Counter:high#2"
        assert arrangement.machine("Counter").turns == 9


def test_others_add_and_remove_one_each_with_its_own_lease() -> None:
    board = Whiteboard.local()
    arrangement = Arrangement([Counter], clock=ManualClock(), whiteboard=board)
    with running(arrangement) as debugger:
        remote, slot = Directory(board).find("Counter"), board[status_slot("Counter")]

        def ask(action: Any, breakpoint: str, lease_s: float = 500.0) -> tuple[str, ...]:
            before = slot.get().obeyed
            remote.send(MachineRequest(action, breakpoint, lease_s))
            wait_for(lambda: slot.get().obeyed > before)
            return debugger.breakpoints

        debugger.break_at("Counter:low")
        assert ask("break", "Counter:high") == ("Counter:low", "Counter:high")
        assert ask("break", "Counter:high") == ("Counter:low", "Counter:high")
        assert ask("clear", "Counter:lo") == ("Counter:low", "Counter:high")
        debugger.proceed()
        assert debugger.wait(PATIENCE_S) == "breakpoint Counter:low"
        assert debugger.pause_left_s() is None
        debugger.proceed()
        assert debugger.wait(PATIENCE_S) == "breakpoint Counter:high"
        assert 0 < (debugger.pause_left_s() or 0) <= 500
        wait_for(lambda: slot.get().paused_left_s is not None)
        assert ask("clear", "Counter:low") == ("Counter:high",)


def test_a_condition_has_no_effect() -> None:
    found = first_pause("Counter:high if self.bump()", [Counter], where)
    assert "bump is more than an expression" in found[0]
    assert "EvaluationError" not in found[0]
    assert found[2] == 3


def test_a_breakpoint_costs_where_it_is() -> None:
    """Turns are not observed, and code of other states is what it was."""
    arrangement = Arrangement([Counter, Driver], whiteboard=Whiteboard.local(), clock=ManualClock())
    states = arrangement.roster.find("Driver").states
    before = {name: (state.on_entry, state.on_exit) for name, state in states.items()}
    debugger = Debugger(arrangement)
    debugger.break_at("Counter:high", "Driver:done->")
    assert not arrangement.kernel.observers
    for name, state in states.items():
        assert ((state.on_entry, state.on_exit) == before[name]) is (name != "done")
    debugger.break_at()
    assert before == {name: (state.on_entry, state.on_exit) for name, state in states.items()}


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("Counter", "'Counter' is not a breakpoint; write Machine:STATE"),
        ("Counter:high if", "is not a breakpoint"),
        ("Counter:high if a b", "its condition is wrong"),
        ("Counter:high if a\0b", "its condition is wrong"),
        ("Counter:high if " + "(" * 900, "its condition is wrong"),
        ("Counter:high if " + "-" * 99_999 + "1", "its condition is wrong"),
        ("Countr:high", "no machine 'Countr'; there are: Counter, Driver; did you mean 'Counter'"),
        ("Counter:hih", "no state of Counter 'hih'; there are: high, low; did you mean 'high'"),
        ("Counter:hih->", "no state of Counter 'hih'"),
        ("Driver:waiting->low", "no transition from waiting to 'low'; there are: done, going"),
        ("@drive", "no slot that a machine reads 'drive'; there are: pose"),
    ],
)
def test_what_does_not_exist_is_refused(text: str, problem: str) -> None:
    arrangement = Arrangement([Counter, Driver], whiteboard=Whiteboard.local())
    debugger = Debugger(arrangement)
    debugger.break_at("Counter:high")
    with pytest.raises(BreakpointError) as raised:
        debugger.break_at("Counter:low", text)
    assert problem in str(raised.value)
    assert debugger.breakpoints == ("Counter:high",)


def test_a_machine_that_is_loaded_later_has_its_breakpoints() -> None:
    arrangement = Arrangement([Driver], whiteboard=Whiteboard.local(), clock=ManualClock())
    debugger = Debugger(arrangement)
    debugger.break_at("Counter:high", library={"Counter": Counter})
    with running(arrangement):
        arrangement.load(Counter)
        debugger.proceed()
        assert debugger.wait(PATIENCE_S) == "breakpoint Counter:high"


def test_one_of_a_state_that_a_reloaded_machine_does_not_have_stays() -> None:
    class Fine(Machine):
        fine = State()
        fine.to(fine, when=lambda m: False)

    arrangement = Arrangement([Counter], whiteboard=Whiteboard.local(), clock=ManualClock())
    debugger = Debugger(arrangement)
    debugger.break_at("Counter:high")
    arrangement.reload("Counter", Fine)
    debugger.break_at("Counter:high", "Counter:fine")
    assert debugger.breakpoints == ("Counter:high", "Counter:fine")
    with running(arrangement):
        debugger.proceed()
        assert debugger.wait(PATIENCE_S) == "breakpoint Counter:fine"
