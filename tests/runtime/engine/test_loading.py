"""Loading, names and requests from outside: what code that holds an arrangement can do."""

from __future__ import annotations

from typing import Any

import pytest

from llfsm.runtime import (
    Arrangement,
    LoadError,
    Machine,
    ManualClock,
    State,
    Status,
    UnknownMachineError,
    define,
)


class A(Machine):
    count: int = 0

    a = State()
    b = State()
    asleep = State(suspend=True)
    a.to(b, when=lambda m: False)

    @a.internal
    def _(self) -> None:
        self.count += 1


class B(A):
    pass


def names(arrangement: Arrangement) -> list[str]:
    return [machine.name for machine in arrangement.machines]


def test_classes_instances_and_names_can_be_loaded():
    instance = A()
    arrangement = Arrangement([A, instance, "Bee"], library={"Bee": B})
    assert names(arrangement) == ["A", "A.0", "B"]
    assert arrangement.machine("A.0") is instance


def test_a_library_may_be_a_function_and_its_entries_any_factory():
    arrangement = Arrangement(library=lambda name: (lambda: A(count=5)) if name == "five" else None)
    assert arrangement.load("five") == 0
    assert arrangement.machine("A").count == 5
    with pytest.raises(UnknownMachineError, match="no machine 'six'; loadable: A"):
        arrangement.load("six")


def test_a_class_once_loaded_is_found_by_its_name():
    arrangement = Arrangement([A])
    assert arrangement.load("A") == 1


def test_unknown_in_the_library():
    with pytest.raises(UnknownMachineError, match="no machine 'C'; loadable: A, B") as caught:
        Arrangement(["C"], library={"B": B, "A": A})
    assert (caught.value.name, caught.value.known) == ("C", ("A", "B"))


@pytest.mark.parametrize("what", [3, int, State(), None])
def test_what_is_no_machine(what: Any):
    with pytest.raises(LoadError, match="is not a machine, a machine class or the name of one"):
        Arrangement([what])


def test_a_factory_that_makes_no_machine():
    with pytest.raises(LoadError, match="'x' is not a machine"):
        Arrangement(["x"], library={"x": lambda: 3})  # type: ignore[dict-item, return-value]


def test_an_instance_is_loaded_once():
    instance = A()
    arrangement = Arrangement([instance])
    with pytest.raises(LoadError, match="A is loaded already: make another instance"):
        arrangement.load(instance)
    with pytest.raises(LoadError, match="A is loaded already"):
        Arrangement([instance])


def test_an_unloaded_instance_can_be_loaded_again_and_starts_afresh_but_for_its_variables():
    instance = A()
    arrangement = Arrangement([instance])
    arrangement.round()
    arrangement.unload("A")
    assert (instance.name, instance.state_name) == ("A", "a")
    arrangement.load(instance)
    arrangement.round()
    assert instance.count == 2


def test_a_machine_of_an_ended_arrangement_can_be_loaded_elsewhere():
    instance = A()
    with Arrangement([instance]):
        pass
    assert Arrangement([instance]).machines == (instance,)


def test_names_can_be_given():
    arrangement = Arrangement()
    arrangement.load(A, name="left")
    arrangement.load(A, name="left")
    assert names(arrangement) == ["left", "left.0"]


def test_two_instances_share_nothing_but_the_table():
    one, other = A(), A()
    arrangement = Arrangement([one, other])
    arrangement.suspend("A")
    arrangement.round()
    assert (one.state_name, other.state_name) == ("asleep", "a")
    assert (one.count, other.count) == (0, 1)


def test_holes_are_filled_by_path():
    arrangement = Arrangement([A, B, A])
    arrangement.unload("A")
    arrangement.unload("B")
    assert names(arrangement) == ["A.0"]
    assert arrangement.control.number_of_machines == 3
    assert arrangement.load(define("A", [State("x")], path="elsewhere")) == 3
    assert arrangement.load(B) == 1
    assert arrangement.load(A, path="elsewhere") == 4
    assert arrangement.load(A) == 0
    assert [arrangement.control.name_of(i) for i in range(5)] == ["A.2", "B", "A.0", "A", "A.1"]


def test_a_library_that_gives_a_path():
    arrangement = Arrangement()
    arrangement.load(A, path="one")
    arrangement.load(B, path="two")
    arrangement.unload("A")
    assert arrangement.load(B, path="one") == 0


# Requests and questions from outside


def test_requests_return_the_status_before():
    arrangement = Arrangement([A, B])
    assert arrangement.suspend("A") is Status.RUNNING
    assert arrangement.status("A") is Status.RUNNING
    arrangement.round()
    assert arrangement.status("A") is Status.SUSPENDED
    assert (arrangement.is_suspended("A"), arrangement.control.is_running("A")) == (True, False)
    assert arrangement.restart("A") is Status.SUSPENDED
    assert arrangement.resume("A") is Status.ERROR
    arrangement.round()
    assert (arrangement.status("A"), arrangement.state_name_of("A")) == (Status.RUNNING, "a")


def test_suspend_all_from_outside_means_all():
    arrangement = Arrangement([A, B])
    arrangement.control.suspend_all()
    arrangement.round()
    assert arrangement.is_suspended("A")
    assert arrangement.is_suspended("B")
    assert arrangement.finished


def test_abandon_from_outside():
    arrangement = Arrangement([A])
    assert arrangement.control.abandon("A") is True
    assert arrangement.state_name_of("A") == "asleep"


NAMED = [
    "suspend",
    "resume",
    "restart",
    "abandon",
    "status",
    "is_suspended",
    "is_running",
    "index_of",
    "state_name_of",
    "unload",
]


@pytest.mark.parametrize("call", NAMED)
def test_every_call_that_takes_a_name_refuses_an_unknown_one(call: str):
    arrangement = Arrangement([A, B])
    arrangement.unload("B")
    with pytest.raises(UnknownMachineError, match="no machine 'B'; loaded: A") as caught:
        getattr(arrangement.control, call)("B")
    assert isinstance(caught.value, LookupError)
    with pytest.raises(UnknownMachineError, match="no machine 'A'; loaded: none"):
        getattr(Arrangement().control, call)("A")


@pytest.mark.parametrize("index", [-1, 1, 2])
def test_no_machine_at_an_index(index: int):
    arrangement = Arrangement([A, B])
    arrangement.unload("B")
    with pytest.raises(UnknownMachineError, match=f"no machine at index {index}; loaded: A"):
        arrangement.control.name_of(index)


# What a machine asks


def test_a_machine_asks_about_itself_and_others():
    answers: list[Any] = []

    class Asker(Machine):
        a = State()

        @a.on_exit
        def _(self) -> None:
            answers.append(self.state_name)  # already the target

        @a.on_entry
        def _(self) -> None:
            answers.extend([self.name, self.state_name, self.index_of("A"), self.name_of(0)])
            answers.extend([self.number_of_machines, self.stopping, self.status("A")])

        b = State()
        a.to(b)

    Arrangement([A, Asker]).round()
    assert answers == ["Asker", "a", 0, "A", 2, False, Status.RUNNING, "b"]


def test_a_machine_loads_classes_and_instances():
    class Loader(Machine):
        a = State()

        @a.on_entry
        def _(self) -> None:
            assert self.load(A) == 1
            assert self.load_suspended(B(count=3)) == 2

    arrangement = Arrangement([Loader])
    arrangement.round()
    assert names(arrangement) == ["A", "B"]
    assert arrangement.machine("B").count == 3


@pytest.mark.parametrize(
    ("ask", "limit_us"),
    [
        (lambda m: m.after_ms(20), 20_000),
        (lambda m: m.after(0.02), 20_000),
        (lambda m: m.timeout(20_000), 20_000),
        (lambda m: m.after_ms(0.5), 500),
    ],
)
def test_times_are_strict(ask: Any, limit_us: int):
    clock = ManualClock(start_ns=123)
    a = A()
    Arrangement([a], clock=clock).round()
    clock.advance(us=limit_us)
    assert ask(a) is False
    clock.advance(ns=1)
    assert ask(a) is True


@pytest.mark.parametrize("guarded", [False, True])
@pytest.mark.parametrize("options", [{"after_ms": 20}, {"after": 0.02}])
def test_timed_transitions_are_strict(options: dict[str, float], guarded: bool):
    a, b = State("a"), State("b")
    a.to(b, when=(lambda m: True) if guarded else None, **options)  # type: ignore[arg-type]
    clock = ManualClock()
    arrangement = Arrangement([define("M", [a, b])], clock=clock)
    arrangement.round()
    clock.advance(ms=20)
    assert arrangement.round() is False
    clock.advance(ns=1)
    assert arrangement.round() is True


def test_a_timed_transition_asks_its_guard_only_when_its_time_has_come():
    asked = []
    a, b = State("a"), State("b")
    a.to(b, after_ms=20, when=lambda m: bool(asked.append(1)))
    clock = ManualClock()
    arrangement = Arrangement([define("M", [a, b])], clock=clock)
    arrangement.round()
    assert not asked
    clock.advance(ms=21)
    assert arrangement.round() is False
    assert asked


def test_the_clock_is_read_at_each_evaluation():
    clock = ManualClock()

    class Slow(Machine):
        a = State()
        b = State()
        c = State()

        @a.to(b)
        def slowly(self) -> bool:
            clock.advance(ms=11)
            return False

        a.to(c, after_ms=10)

    slow = Slow()
    Arrangement([slow], clock=clock).round()
    assert slow.state_name == "c"


def test_an_error_lists_no_more_names_than_can_be_read() -> None:
    with pytest.raises(UnknownMachineError) as caught:
        raise UnknownMachineError("Machine1000", [f"Machine{number}" for number in range(1000)])
    assert "Machine19 and 980 more; did you mean 'Machine" in str(caught.value)
    assert len(str(caught.value)) < 400
