"""Machines that call others and wait for what they compute."""

from __future__ import annotations

from typing import Any

import pytest

from llfsm.runtime import (
    Actuator,
    Arrangement,
    ExecutionError,
    Machine,
    ManualClock,
    Reason,
    State,
    Submachine,
    Trace,
    UnknownMachineError,
)
from llfsm.runtime.bundles import (
    Bundle,
    BundleState,
    BundleTransition,
    Fragment,
    compile_bundle,
)
from llfsm.runtime.engine.events import Call, Turn
from llfsm.whiteboard import Message, Slot, Whiteboard


class Number(Message):
    value: int = 0


SAID = Slot("said", Number)


class Says(Machine):
    """Say a number, for ever."""

    what: int = 1

    say = Actuator(SAID, at_end=Number(-7))

    saying = State()
    never = State()
    saying.to(never, when=lambda m: False)

    @saying.internal
    def _(self) -> None:
        self.say(Number(self.what))


class Square(Machine):
    """Take a few turns to square a number."""

    number: int = 0
    result: int | None = None
    patience: int = 3

    thinking = State()
    ready = State()

    @thinking.internal
    def _(self) -> None:
        self.patience -= 1

    @thinking.to(ready)
    def thought(self) -> bool:
        return self.patience == 0

    @ready.on_entry
    def _(self) -> None:
        self.result = self.number * self.number


class Stuck(Machine):
    a = State()
    b = State()
    a.to(b, when=lambda m: False)


class Breaks(Machine):
    """Raise in its second turn."""

    turns: int = 0
    a = State()
    b = State()
    a.to(b, when=lambda m: False)

    @a.internal
    def _(self) -> None:
        self.turns += 1
        if self.turns == 2:
            raise ValueError("bang")


class Sums(Machine):
    """Sum squares that another machine computes, one call after another."""

    upto: int = 3
    next: int = 1
    total: int = 0
    called: Any = None
    library_name: str = ""

    calling = State()
    adding = State()
    done = State()

    @calling.on_entry
    def _(self) -> None:
        what = self.library_name or Square
        self.called = self.call_machine(what, variables={"number": self.next})

    calling.to(adding, when=lambda self: self.called.done)

    @adding.on_entry
    def _(self) -> None:
        self.total += self.called.machine.result
        self.next += 1

    adding.to(done, when=lambda self: self.next > self.upto)
    adding.to(calling)


class Calls(Machine):
    """Call a machine and do as one likes with it."""

    what: Any = None
    called: Any = None
    a = State()
    b = State()
    a.to(b, when=lambda m: False)

    @a.on_entry
    def _(self) -> None:
        self.called = self.call_machine(self.what)


class Counts(Machine):
    rounds: int = 0
    a = State()
    b = State()
    a.to(b, when=lambda m: False)

    @a.internal
    def _(self) -> None:
        self.rounds += 1


@pytest.mark.parametrize("observed", [False, True])
@pytest.mark.parametrize("unload_accepting", [True, False])
def test_a_machine_sums_what_others_compute(unload_accepting: bool, observed: bool):
    sums = Sums(upto=4)
    arrangement = Arrangement(
        [sums],
        clock=ManualClock(),
        unload_accepting=unload_accepting,
        observers=[Trace()] if observed else [],
    )
    assert arrangement.run(max_rounds=200) is Reason.ACCEPTING
    assert sums.total == 1 + 4 + 9 + 16
    # Several calls in a row use one hole, unless machines that accept stay.
    assert arrangement.number_of_machines == (2 if unload_accepting else 5)


def test_a_call_by_name_finds_the_library():
    sums = Sums(library_name="Sq")
    Arrangement([sums], clock=ManualClock(), library={"Sq": Square}).run(max_rounds=200)
    assert sums.total == 14
    assert sums.called.name == "Square"


def test_a_call_of_nobody_is_an_error_of_its_caller():
    arrangement = Arrangement([Sums(library_name="Nobody")])
    with pytest.raises(ExecutionError, match="machine Sums, state calling, OnEntry") as caught:
        arrangement.round()
    assert isinstance(caught.value.__cause__, UnknownMachineError)
    assert "no machine 'Nobody'; loadable: Sums" in str(caught.value)


def test_a_call_never_blocks_anybody():
    counts, sums, trace = Counts(), Sums(), Trace()
    arrangement = Arrangement([counts, sums], clock=ManualClock(), observers=[trace])
    while sums.next <= sums.upto:
        arrangement.round()
        assert counts.rounds == arrangement.rounds
    turns = [(event.round, event.machine) for event in trace if isinstance(event, Turn)]
    for number in range(1, arrangement.rounds + 1):
        took = [machine for round, machine in turns if round == number]
        assert took in (["Counts", "Sums", "Square"], ["Counts", "Sums"])


def test_a_called_machine_has_its_first_turn_in_the_round_of_the_call():
    trace = Trace()
    arrangement = Arrangement([Sums], clock=ManualClock(), observers=[trace])
    arrangement.round()
    assert trace.sections()[:3] == [
        (1, "Sums", "OnEntry", "calling"),
        (1, "Sums", "Internal", "calling"),
        (1, "Square", "OnEntry", "thinking"),
    ]
    (call,) = [event for event in trace if isinstance(event, Call)]
    assert (call.operation, call.argument) == ("call_machine", "Square")
    assert isinstance(call.result, Submachine)


def test_done_is_told_when_it_accepts_and_its_results_stay():
    arrangement = Arrangement([Counts], clock=ManualClock())
    square = arrangement.call_machine(Square, name="sq", variables={"number": 12})
    seen = []
    for _ in range(6):
        arrangement.round()
        seen.append((square.done, square.failed, square.machine.state_name))
    assert seen[:4] == [(False, False, "thinking")] * 3 + [(False, False, "ready")]
    assert seen[4:] == [(True, False, "ready")] * 2
    assert square.machine.result == 144
    assert (square.name, repr(square)) == ("sq", "<Submachine sq: done>")
    assert len(arrangement.machines) == 1


def test_a_call_takes_slots_and_a_name():
    board = Whiteboard.local()
    arrangement = Arrangement(whiteboard=board)
    called = arrangement.call_machine(
        Says, name="mine", variables={"what": 4}, slots={"said": "there"}
    )
    arrangement.round()
    assert (called.name, board.get_message(Slot("there", Number))) == ("mine", Number(4))
    assert repr(called) == "<Submachine mine: in saying>"


def test_a_machine_that_is_cancelled_has_failed_and_posts_its_last():
    board = Whiteboard.local()
    arrangement = Arrangement([Counts], whiteboard=board)
    called = arrangement.call_machine(Says)
    arrangement.round()
    called.cancel()
    assert (called.done, called.failed, repr(called)) == (False, True, "<Submachine Says: failed>")
    assert board.get_message(SAID) == Number(-7)
    assert len(arrangement.machines) == 1


def test_cancelling_twice_or_after_the_end_changes_nothing():
    arrangement = Arrangement([Counts], clock=ManualClock())
    first, second = arrangement.call_machine(Stuck), arrangement.call_machine(Square)
    arrangement.round()
    first.cancel()
    again = arrangement.call_machine(Stuck)  # takes the name and the hole
    first.cancel()
    for _ in range(6):
        arrangement.round()
    second.cancel()
    assert (again.failed, arrangement.index_of("Stuck")) == (False, 1)
    assert (second.done, second.failed) == (True, False)


def test_one_that_is_unloaded_by_somebody_has_failed():
    arrangement = Arrangement([Counts])
    called = arrangement.call_machine(Stuck)
    arrangement.round()
    arrangement.unload("Stuck")
    assert (called.done, called.failed) == (False, True)


def test_one_that_was_asked_to_stop_and_did_not_has_failed():
    arrangement = Arrangement([Counts], clock=ManualClock())
    called = arrangement.call_machine(Stuck)
    arrangement.stop_machine("Stuck")
    arrangement.run(max_rounds=20, grace_s=0.1)
    assert (called.done, called.failed) == (False, True)


@pytest.mark.parametrize("suspended", [False, True])
def test_one_whose_code_raised_has_failed(suspended: bool):
    arrangement = Arrangement([Counts], clock=ManualClock(), on_error="suspend")

    class BreaksAsleep(Breaks):
        asleep = State(suspend=True)

        @asleep.internal
        def _(self) -> None:
            raise ValueError("bang")

    called = arrangement.call_machine(BreaksAsleep if suspended else Breaks)
    if suspended:
        arrangement.suspend(called.name)
    for _ in range(4):
        arrangement.round()
    assert (called.done, called.failed) == (False, True)


def test_when_all_has_ended_what_was_not_done_has_failed():
    arrangement = Arrangement([Counts], clock=ManualClock())
    stuck, square = arrangement.call_machine(Stuck), arrangement.call_machine(Square)
    arrangement.run(max_rounds=10)
    assert (stuck.failed, square.failed, square.done) == (True, False, True)
    stuck.cancel()


def test_a_called_machine_outlives_its_caller():
    caller = Calls(what=Square)
    arrangement = Arrangement([Counts, caller], clock=ManualClock())
    arrangement.round()
    arrangement.unload("Calls")
    for _ in range(6):
        arrangement.round()
    assert caller.called.done


def test_a_suspended_machine_in_an_accepting_state_is_not_done():
    class Rests(Machine):
        a = State()
        asleep = State(suspend=True)

    arrangement = Arrangement([Counts], clock=ManualClock())
    called = arrangement.call_machine(Rests)
    arrangement.suspend("Rests")
    arrangement.round()
    arrangement.round()
    assert (called.done, called.failed) == (False, False)
    arrangement.resume("Rests")
    arrangement.round()
    assert called.done


def test_where_accepting_machines_stay_one_is_done_until_it_is_restarted():
    arrangement = Arrangement([Counts], clock=ManualClock(), unload_accepting=False)
    square = arrangement.call_machine(Square, variables={"number": 5})
    for _ in range(6):
        arrangement.round()
    assert (square.done, square.failed) == (True, False)
    assert len(arrangement.machines) == 2
    arrangement.restart("Square")
    square.machine.patience = 2
    arrangement.round()
    assert (square.done, square.failed) == (False, False)
    for _ in range(4):
        arrangement.round()
    assert square.done
    square.cancel()
    assert (square.done, square.failed) == (True, False)
    assert len(arrangement.machines) == 1


def test_a_caller_may_cancel_one_inside_whose_ringlet_it_runs():
    class Tyrant(Machine):
        caller: str = "Boss"
        a = State()
        b = State()
        a.to(b, when=lambda m: False)

        @a.on_entry
        def _(self) -> None:
            self.abandon(self.caller)  # runs the caller's suspend state in here
            self.caller = self.state_name  # it is still in its own ringlet

    class Boss(Machine):
        called: Any = None
        a = State()
        b = State()
        asleep = State(suspend=True)
        a.to(b, when=lambda m: False)

        @a.on_entry
        def _(self) -> None:
            self.called = self.call_machine(Tyrant)

        @asleep.on_entry
        def _(self) -> None:
            self.called.cancel()

    boss = Boss()
    arrangement = Arrangement([boss, Counts], clock=ManualClock())
    arrangement.round()
    assert boss.called.failed
    assert boss.called.machine.caller == "a"
    assert [machine.name for machine in arrangement.machines] == ["Boss", "Counts"]


def test_a_machine_that_calls_itself_again_and_again_is_only_loaded_again():
    class Deep(Machine):
        depth: int = 3
        called: Any = None
        sum: int = 0
        down = State()
        up = State()

        @down.on_entry
        def _(self) -> None:
            if self.depth:
                self.called = self.call_machine(Deep, variables={"depth": self.depth - 1})

        down.to(up, when=lambda m: m.called is None or m.called.done)

        @up.on_entry
        def _(self) -> None:
            self.sum = self.depth + (self.called.machine.sum if self.called else 0)

    deep = Deep()
    assert Arrangement([deep], clock=ManualClock()).run(max_rounds=100) is Reason.ACCEPTING
    assert deep.sum == 6


def test_a_bundle_calls_a_machine():
    wait = BundleTransition("Done", Fragment("called.done\n"))
    states = (
        BundleState(
            "Call",
            {"OnEntry": Fragment("called = call_machine('Square', variables={'number': 7})\n")},
            (wait,),
        ),
        BundleState("Done", {"OnEntry": Fragment("result = called.machine.result\n")}),
    )
    variables = Fragment("called: object = None\nresult: int = 0\n")
    caller = compile_bundle(Bundle("Caller", states, variables=variables))()
    arrangement = Arrangement([caller], clock=ManualClock(), library={"Square": Square})
    assert arrangement.run(max_rounds=50) is Reason.ACCEPTING
    assert caller.result == 49  # type: ignore[attr-defined]


def test_a_bundle_is_called():
    states = (
        BundleState("Work", transitions=(BundleTransition("End", Fragment("after_ms(50)\n")),)),
        BundleState("End", {"OnEntry": Fragment("result = name.upper()\n")}),
    )
    bundle = compile_bundle(Bundle("Work", states, variables=Fragment("result: str = ''\n")))
    arrangement = Arrangement([Counts], clock=ManualClock(), library={"Work": bundle})
    called = arrangement.call_machine("Work", name="two")
    arrangement.run(max_rounds=20)
    assert called.done
    assert called.machine.result == "TWO"  # type: ignore[attr-defined]
