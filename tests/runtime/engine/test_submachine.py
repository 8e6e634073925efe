"""Machines that call others and wait for what they compute."""

from __future__ import annotations

from typing import Any

import pytest

from llfsm.runtime import (
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
from llfsm.runtime.bundles import Bundle, BundleState, BundleTransition, Fragment, compile_bundle
from llfsm.runtime.engine.events import Call, Turn
from llfsm.whiteboard import Slot, Whiteboard

from .submachines import Calls, Counts, Number, Says, Square, Sums


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
    # Several calls in a row use one hole: also where machines that accept stay, calls end.
    assert arrangement.control.number_of_machines == 2


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


def test_a_call_takes_slots_and_a_name():
    board = Whiteboard.local()
    arrangement = Arrangement(whiteboard=board)
    called = arrangement.call_machine(
        Says, name="mine", variables={"what": 4}, slots={"said": "there"}
    )
    arrangement.round()
    assert (called.name, board.get_message(Slot("there", Number))) == ("mine", Number(4))
    assert repr(called) == "<Submachine mine: in saying>"


def test_a_detached_call_outlives_its_caller():
    caller = Calls(what=Square, detached=True)
    arrangement = Arrangement([Counts, caller], clock=ManualClock())
    arrangement.round()
    arrangement.unload("Calls")
    for _ in range(6):
        arrangement.round()
    assert caller.called.done


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
