"""One class many times: instances with slots of their own, and machines that call others."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from llfsm.runtime import (
    Actuator,
    Arrangement,
    ExecutionError,
    LoadError,
    Machine,
    ManualClock,
    Reason,
    Sensor,
    State,
    Submachine,
    Trace,
    UnknownMachineError,
    VariableError,
)
from llfsm.runtime.bundles import (
    Bundle,
    BundleState,
    BundleTransition,
    Fragment,
    compile_bundle,
)
from llfsm.runtime.events import Call, Turn
from llfsm.whiteboard import Message, Slot, SlotNameError, SlotTypeError, Whiteboard


class Number(Message):
    value: int = 0


class Text(Message):
    value: str = ""


HEARD, SAID, SHARED = Slot("heard", Number), Slot("said", Number), Slot("shared", Number)


class Adder(Machine):
    """Say what is heard and a little more, for ever."""

    more: int = 0

    heard = Sensor(HEARD, default=Number(-1))
    shared = Sensor(SHARED)
    say = Actuator(SAID, at_end=Number(-7))

    adding = State()
    never = State()
    adding.to(never, when=lambda m: False)

    @adding.internal
    def _(self) -> None:
        also = 0 if self.shared is None else self.shared.value
        self.say(Number(self.heard.value + self.more + also))


def value(board: Any, slot: str) -> int | None:
    message = board.get_message(Slot(slot, Number))
    return None if message is None else message.value


# Instances


@given(st.lists(st.tuples(st.integers(0, 99), st.integers(0, 99)), min_size=1, max_size=6))
def test_each_instance_has_slots_and_variables_of_its_own(given_to: list[tuple[int, int]]):
    board = Whiteboard.local()
    arrangement = Arrangement(whiteboard=board, clock=ManualClock())
    for number, (heard, more) in enumerate(given_to):
        slots = {"heard": f"{number}/heard", "said": f"{number}/said"}
        arrangement.load(Adder, name=f"adder{number}", variables={"more": more}, slots=slots)
        board.add_message(Slot(f"{number}/heard", Number), Number(heard))
    board.add_message(SHARED, Number(1_000))  # which nobody has renamed
    arrangement.round()
    for number, (heard, more) in enumerate(given_to):
        assert value(board, f"{number}/said") == heard + more + 1_000
    assert (value(board, "heard"), value(board, "said")) == (None, None)
    arrangement.end()
    assert {value(board, f"{number}/said") for number in range(len(given_to))} == {-7}


def test_the_default_of_a_sensor_holds_in_its_new_slot_too():
    board = Whiteboard.local()
    arrangement = Arrangement(whiteboard=board)
    arrangement.load(Adder, slots={"heard": "mine"})
    board.add_message(HEARD, Number(5))
    arrangement.round()
    assert value(board, "said") == -1


def test_the_slots_of_a_class_stay_what_they_are():
    board = Whiteboard.local()
    arrangement = Arrangement(whiteboard=board)
    arrangement.load(Adder, slots={"said": "mine"})
    arrangement.load(Adder)
    arrangement.round()
    assert (value(board, "mine"), value(board, "said")) == (-1, -1)
    assert Adder.say.slot is SAID


def test_two_ports_of_one_slot_are_connected_to_another_one_together():
    class Echo(Machine):
        read = Sensor(SHARED, default=Number())
        write = Actuator(SHARED)
        a = State()

        @a.internal
        def _(self) -> None:
            self.write(Number(self.read.value + 1))

    board = Whiteboard.local()
    board.add_message(Slot("x", Number), Number(41))
    arrangement = Arrangement(whiteboard=board)
    arrangement.load(Echo, slots={"shared": "x"})
    arrangement.round()
    assert (value(board, "x"), value(board, "shared")) == (42, None)


def test_slots_may_be_swapped():
    board = Whiteboard.local()
    board.add_message(SAID, Number(4))
    arrangement = Arrangement(whiteboard=board)
    arrangement.load(Adder, slots={"heard": "said", "said": "heard"})
    arrangement.round()
    assert (value(board, "said"), value(board, "heard")) == (4, 4)


def test_a_name_that_is_taken_gets_a_number():
    arrangement = Arrangement(whiteboard=Whiteboard.local())
    for _ in range(3):
        arrangement.load(Adder, name="bob")
    arrangement.unload("bob.0")
    arrangement.load(Adder, name="bob", variables={"more": 4})
    names = [machine.name for machine in arrangement.machines]
    assert names == ["bob", "bob.0", "bob.1"]
    assert arrangement.machine("bob.0").more == 4
    assert arrangement.index_of("bob.0") == 1  # a hole of its class


def test_an_instance_suspended_from_the_start_has_its_own_slots_too():
    board = Whiteboard.local()
    arrangement = Arrangement(whiteboard=board)
    arrangement.load_suspended(Adder, name="late", variables={"more": 3}, slots={"said": "mine"})
    arrangement.resume("late")
    arrangement.round()
    assert value(board, "mine") == 2


def test_an_instance_that_is_made_already_can_be_given_a_name_and_slots():
    board, adder = Whiteboard.local(), Adder(more=9)
    arrangement = Arrangement(whiteboard=board)
    arrangement.load(adder, name="nine", slots={"said": "mine"})
    arrangement.round()
    assert (adder.name, value(board, "mine")) == ("nine", 8)


def test_a_machine_loads_others_with_slots_of_their_own():
    class Loader(Machine):
        a = State()

        @a.on_entry
        def _(self) -> None:
            self.load("Adder", name="one", variables={"more": 1}, slots={"said": "one"})
            self.load_suspended(Adder, name="two", variables={"more": 2}, slots={"said": "two"})
            self.resume("two")

    board = Whiteboard.local()
    arrangement = Arrangement([Loader], whiteboard=board, library={"Adder": Adder})
    arrangement.round()
    assert (value(board, "one"), value(board, "two")) == (0, 1)


# What cannot be loaded so


@pytest.mark.parametrize(
    ("machine", "how", "error", "message"),
    [
        (
            Adder,
            {"slots": {"herad": "x"}},
            LoadError,
            "Adder uses no slot 'herad'; it uses: heard, shared, said$",
        ),
        (
            Adder,
            {"name": "bob", "slots": {"x/heard": "heard"}},
            LoadError,
            "bob uses no slot 'x/heard'; it uses: heard",
        ),
        (Adder, {"slots": {"said": "text"}}, SlotTypeError, "slot 'text' holds Text, not our Num"),
        (Adder, {"slots": {"heard": "text"}}, SlotTypeError, "slot 'text' holds Text, not our Num"),
        (Adder, {"slots": {"said": "white space"}}, SlotNameError, "'white space' cannot name a"),
        (Adder, {"variables": {"mroe": 1}}, VariableError, "Adder has no variable 'mroe'"),
        (Adder, {"variables": {"more": "x"}}, VariableError, "more = 'x'"),
        (Adder(), {"variables": {"more": 1}}, LoadError, "Adder is made already: give its"),
        ("made", {"variables": {"more": 1}}, LoadError, "Adder is made already: give its"),
    ],
)
def test_what_cannot_be_loaded_leaves_nothing(
    machine: Any, how: dict[str, Any], error: type[Exception], message: str
):
    board = Whiteboard.local()
    board.add_message(Slot("text", Text), Text("hello"))
    arrangement = Arrangement(whiteboard=board, library={"made": lambda: Adder(more=1)})
    with pytest.raises(error, match=message):
        arrangement.load(machine, **how)
    assert (arrangement.number_of_machines, arrangement.machines) == (0, ())
    assert board.get_message(SAID) is None  # nothing at_end
    arrangement.load(Adder)  # the next one is as if nothing had been
    assert arrangement.machines[0].name == "Adder"


def test_a_machine_without_slots_has_none_to_rename():
    class Deaf(Machine):
        a = State()

    with pytest.raises(LoadError, match="Deaf uses no slot 'heard'; it uses: none"):
        Arrangement().load(Deaf, slots={"heard": "x"})


# Submachines


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
        Adder, name="mine", variables={"more": 5}, slots={"said": "there"}
    )
    arrangement.round()
    assert (called.name, value(board, "there")) == ("mine", 4)
    assert repr(called) == "<Submachine mine: in adding>"


def test_a_machine_that_is_cancelled_has_failed_and_posts_its_last():
    board = Whiteboard.local()
    arrangement = Arrangement([Counts], whiteboard=board)
    called = arrangement.call_machine(Adder)
    arrangement.round()
    called.cancel()
    assert (called.done, called.failed, repr(called)) == (False, True, "<Submachine Adder: failed>")
    assert value(board, "said") == -7
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
