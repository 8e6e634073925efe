"""One class many times: instances with slots and variables of their own."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from llfsm.runtime import (
    Actuator,
    Arrangement,
    LoadError,
    Machine,
    ManualClock,
    Sensor,
    State,
    VariableError,
)
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
    assert arrangement.control.index_of("bob.0") == 1  # a hole of its class


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
            "Adder uses no slot 'herad'; it uses: heard, shared, said; did you mean 'heard'",
        ),
        (
            Adder,
            {"name": "bob", "slots": {"x/heard": "heard"}},
            LoadError,
            "bob uses no slot 'x/heard'; it uses: heard",
        ),
        (Adder, {"slots": {"said": "text"}}, SlotTypeError, "slot 'text' holds Text, not our Num"),
        (Adder, {"slots": {"heard": "text"}}, SlotTypeError, "slot 'text' holds Text, not our Num"),
        (
            Adder,
            {"slots": {"said": "white space"}},
            SlotNameError,
            "'white space' is not a valid",
        ),
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
    assert (arrangement.control.number_of_machines, arrangement.machines) == (0, ())
    assert board.get_message(SAID) is None  # nothing at_end
    arrangement.load(Adder)  # the next one is as if nothing had been
    assert arrangement.machines[0].name == "Adder"


def test_a_machine_without_slots_has_none_to_rename():
    class Deaf(Machine):
        a = State()

    with pytest.raises(LoadError, match="Deaf uses no slot 'heard'; it uses: none"):
        Arrangement().load(Deaf, slots={"heard": "x"})
