"""What is wrong with a machine class is found when it is made."""

from __future__ import annotations

import warnings
from typing import Any

import pytest

from llfsm.runtime import (
    Actuator,
    DefinitionError,
    Machine,
    Sensor,
    State,
    UnreachableStateWarning,
    define,
)
from llfsm.whiteboard import Message, Slot


class Number(Message):
    value: int = 0


NUMBER = Slot("number", Number)


class Door(Machine):
    closed = State()
    ajar = State()
    closed.to(ajar, after_ms=500)
    ajar.to(closed, after_ms=500)


def body_error(match: str) -> Any:
    return pytest.raises(DefinitionError, match=match)


def test_no_states():
    with body_error("Empty declares no states"):

        class Empty(Machine):
            pass


@pytest.mark.parametrize(
    "again", [State, lambda: Sensor(NUMBER), lambda: Actuator(NUMBER)], ids=["s", "r", "a"]
)
def test_a_name_declared_twice(again: Any):
    with body_error("Twice: 'a' is declared twice"):

        class Twice(Machine):
            a = State()
            a = again()  # noqa: PIE794


def test_a_sensor_hidden_by_a_variable():
    with body_error("'pose' is declared twice"):

        class Twice(Machine):
            pose = Sensor(NUMBER)
            pose: int = 0  # type: ignore[no-redef]  # noqa: PIE794
            a = State()


def test_two_states_of_one_name():
    with body_error("two states are called 'a'"):
        define("Twins", [State("a"), State("a")])


def test_a_state_without_name():
    with body_error("Nameless: a state has no name"):
        define("Nameless", [State()])


def test_one_state_with_two_names():
    with body_error("'a' is also called 'b'; give it one name"):

        class Alias(Machine):
            a = b = State()


def test_a_section_given_twice():
    with body_error("state 'x': OnEntry is given twice"):
        x = State("x")
        x.on_entry(lambda m: None)
        x.on_entry(lambda m: None)


def test_a_guard_given_twice():
    a = State("a")
    with body_error("two guards"):
        a.to(a, when=lambda m: True)(lambda m: False)


def test_a_transition_after_an_unconditional_one():
    with body_error(r"Dead, state 'a': the transition to 'b' can never fire"):

        class Dead(Machine):
            a = State()
            b = State()
            a.to(a)
            a.to(b, when=lambda m: True)


def test_a_transition_to_a_state_of_another_machine():
    with body_error(r"'go' leads to a state 'closed' that belongs to Door"):

        class Lost(Machine):
            a = State()

            @a.to(Door.closed)
            def go(self) -> bool:
                return True


def test_a_transition_to_a_state_of_no_machine():
    with body_error("'true' leads to a state '' that is not its own"):

        class Lost(Machine):
            a = State()
            a.to(State())


def test_a_transition_to_no_state():
    with body_error("a transition leads to a State, not to 'b'"):
        State("a").to("b")  # type: ignore[arg-type]


def test_a_state_of_another_class():
    a = State("a")
    define("First", [a])
    with body_error("Second: state 'a' belongs to First"):
        define("Second", [a])


def test_two_suspend_states():
    with body_error("'a' and 'b' are both declared as the suspend state"):
        define("Both", [State("a", suspend=True), State("b", suspend=True)])


@pytest.mark.parametrize("name", ["suspend", "name", "after_ms", "load", "stopping", "table"])
def test_names_that_would_hide_the_machines_own(name: str):
    with body_error(f"{name!r} would hide what every machine has"):
        define("Hidden", [State("a")], attributes={name: 1})
    with body_error(f"{name!r} would hide"):
        define("Hidden", [State("a")], variables={name: (int, 0)})


def test_a_mixin_must_not_hide_them_either():
    class Mixin:
        def suspend(self) -> None: ...

    with body_error("Mixin: 'suspend' would hide"):

        class Hidden(Mixin, Machine):  # type: ignore[misc]
            a = State()


def test_a_state_may_be_called_like_a_control_function_if_the_attribute_is_not():
    class Loader(Machine):
        loading = State("load")

    assert Loader.table.initial.name == "load"


@pytest.mark.parametrize("value", [[], {}, set(), bytearray()])
def test_a_mutable_attribute_that_machines_would_share(value: Any):
    with body_error("Sharing: machines would share 'seen'; annotate it"):
        define("Sharing", [State("a")], attributes={"seen": value})


@pytest.mark.parametrize("time", [-1, float("nan"), float("inf"), True, "1"])
def test_impossible_times(time: Any):
    a = State("a")
    with body_error("waits for a time of 0 or more"):
        a.to(a, after_ms=time)
    with body_error("waits for a time of 0 or more"):
        a.to(a, after=time)


def test_two_times():
    a = State("a")
    with body_error("after_ms or after, not both"):
        a.to(a, after_ms=1, after=1)


async def asynchronous(machine: Machine) -> None: ...


def generating(machine: Machine) -> Any:
    yield


@pytest.mark.parametrize("code", [asynchronous, generating, None, 3])
def test_code_that_would_do_nothing_when_called(code: Any):
    a = State("a")
    with body_error("Internal must be a plain function"):
        a.internal(code)
    with body_error("a guard must be a plain function"):
        a.to(a)(code)


def test_a_complete_class_cannot_be_extended_from_outside():
    with body_error("Door is complete: extend its state 'closed' in the body of a subclass"):
        Door.closed.to(Door.ajar)
    with body_error("Door is complete"):
        Door.ajar.on_exit(lambda m: None)


def test_a_subclass_extends_no_state_of_a_stranger():
    other = define("Other", [State("closed")])
    with body_error("Other is complete: extend its state 'closed'"):

        class Confused(Door):
            other.table.initial.on_exit(lambda m: None)


def test_machines_are_made_by_class_statements():
    with body_error("class statement or define"):
        type(Machine)("Plain", (Machine,), {"a": State()})


def test_machine_itself_is_no_machine():
    with body_error("Machine has no states"):
        Machine()


def test_two_parents():
    with body_error("Both: a machine extends one machine"):

        class Both(Door, define("Other", [State("a")])):  # type: ignore[misc]
            pass


# Unreachable states


def test_states_that_no_transition_leads_to():
    with pytest.warns(
        UnreachableStateWarning, match="Island: no transitions lead to state 'c'"
    ) as w:

        class Island(Machine):
            a = State()
            b = State()
            c = State()
            a.to(b)
            c.to(a)

    assert [str(x.message).partition(" state ")[2] for x in w] == ["'c'"]
    assert w[0].filename == __file__


def test_the_suspend_state_and_what_it_leads_to_are_reached():
    with warnings.catch_warnings():
        warnings.simplefilter("error")

        class Sleeper(Machine):
            a = State()
            asleep = State(suspend=True)
            dreaming = State()
            asleep.to(dreaming)
