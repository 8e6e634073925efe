"""The table that is made of a machine class is what everything reads."""

from __future__ import annotations

import functools
import linecache
from typing import Any, ClassVar, Final

import pytest

from llfsm.runtime import (
    Actuator,
    Arrangement,
    DefinitionError,
    Machine,
    Sensor,
    State,
    define,
)
from llfsm.whiteboard import Message, Slot


class Number(Message):
    value: int = 0


NUMBER = Slot("number", Number)


class Door(Machine):
    opened: int = 0

    closed = State()
    ajar = State()
    waiting = State(suspend=True)

    @closed.on_entry
    def shut(self) -> None:
        self.opened = 0

    @closed.to(ajar)
    def pushed(self) -> bool:
        return self.opened == 0

    ajar.to(closed, after_ms=500)


def arrows(cls: type[Machine]) -> list[tuple[str, str, str]]:
    return [
        (state.name, transition.label, transition.target.name)
        for state in cls.table.states
        for transition in state.transitions
    ]


def test_the_table_has_states_in_order_and_the_first_is_initial():
    table = Door.table
    assert [state.name for state in table.states] == ["closed", "ajar", "waiting"]
    assert table.initial is Door.closed
    assert table.suspend is Door.waiting
    assert list(table.variables) == ["opened"]
    assert arrows(Door) == [("closed", "pushed", "ajar"), ("ajar", "after_ms(500)", "closed")]


def test_the_path_is_module_and_name():
    assert Door.table.path == f"{__name__}:Door"


# Labels


class Labelled(Machine):
    count: int = 0

    a = State()
    b = State()
    a.to(b, when=lambda m: m.count > 3)
    a.to(b, when=lambda m: m.count == 1), a.to(b, when=lambda m: m.count == 2)
    a.to(b, after=1.5, when=lambda m: m.name == "x")

    @a.to(b)
    def _(self) -> bool:
        """Say why."""
        return (
            self.count < 0  # a text of two lines
            and not self.stopping
        )

    @a.to(b, after_ms=10)
    def named(self) -> bool:
        count = self.count
        return count > 0

    a.to(b, when=functools.partial(lambda m, n: m.count == n, n=3))
    a.to(b, label="given")


def test_labels_and_expressions():
    transitions = Labelled.a.transitions
    assert [t.label for t in transitions[:6]] == [
        "m.count > 3",
        "m.count == 1",
        "m.count == 2",
        'after(1.5) and m.name == "x"',
        "self.count < 0 and (not self.stopping)",  # in one line
        "after_ms(10) and named",
    ]
    assert [t.expression for t in transitions[:3]] == [
        "m.count > 3",
        "m.count == 1",
        "m.count == 2",
    ]
    assert transitions[5].expression is None  # no single expression
    assert transitions[7].label == "given"


def test_without_source_the_label_is_the_place():
    namespace: dict[str, Any] = {}
    exec(compile("guard = lambda m: True", "nowhere.py", "exec"), namespace)
    a = State("a")
    assert a.to(a, when=namespace["guard"]).label == "nowhere.py:1"
    assert Labelled.a.transitions[6].label.startswith(__file__)  # a partial has no source


def test_locations_are_the_guards_or_the_declarations():
    pushed = Door.closed.transitions[0]
    assert pushed.location == (__file__, Door.pushed.__code__.co_firstlineno)
    filename, line = Door.ajar.transitions[0].location
    assert filename == __file__
    assert "after_ms=500" in linecache.getline(filename, line)


def test_times_are_kept_in_milliseconds():
    assert Door.ajar.transitions[0].after_ms == 500
    assert Labelled.a.transitions[3].after_ms == 1500
    assert Door.closed.transitions[0].after_ms is None


# Subclasses


def snapshot(cls: type[Machine]) -> Any:
    return [
        (s.name, dict(s.sections), [(t.label, t.target.name, t.guard) for t in s.transitions])
        for s in cls.table.states
    ]


def test_a_subclass_extends_a_copy():
    before = snapshot(Door)

    class Alarmed(Door):
        ringing = State()

        @Door.closed.on_exit
        def _(self) -> None: ...

        @Door.ajar.to(ringing)
        def long_ajar(self) -> bool:
            return self.after_ms(400)

        ringing.to(Door.closed)

    assert snapshot(Door) == before
    assert [s.name for s in Alarmed.table.states] == ["closed", "ajar", "waiting", "ringing"]
    assert arrows(Alarmed) == [
        ("closed", "pushed", "ajar"),
        ("ajar", "after_ms(500)", "closed"),
        ("ajar", "long_ajar", "ringing"),
        ("ringing", "true", "closed"),
    ]
    assert all(
        t.target in Alarmed.table.states for s in Alarmed.table.states for t in s.transitions
    )
    assert Alarmed.closed is Alarmed.table.initial
    assert Alarmed.closed is not Door.closed
    assert set(Alarmed.closed.sections) == {"OnEntry", "OnExit"}
    assert Alarmed.table.suspend is Alarmed.waiting


def test_a_section_of_a_subclass_replaces_the_inherited_one():
    class Quiet(Door):
        @Door.closed.on_entry
        def _(self) -> None: ...

    class Quieter(Quiet):
        @Door.closed.on_entry
        def _(self) -> None: ...

    assert len({cls.closed.sections["OnEntry"] for cls in (Door, Quiet, Quieter)}) == 3
    with pytest.raises(DefinitionError, match="OnEntry is given twice"):

        class Twice(Door):
            Door.closed.on_entry(lambda m: None)
            Door.closed.on_entry(lambda m: None)


def test_a_method_takes_the_place_of_the_guard_or_section_it_is_named_after():
    class Stuck(Door):
        def pushed(self) -> bool:
            return False

        def shut(self) -> None: ...

    assert Stuck.closed.transitions[0].guard is Stuck.pushed
    assert Stuck.closed.sections["OnEntry"] is Stuck.shut
    assert Door.closed.transitions[0].guard is Door.pushed


def test_a_state_declared_again_replaces_the_inherited_one():
    class Other(Door):
        ajar = State()
        ajar.to(Door.closed, after_ms=1)

    assert [s.name for s in Other.table.states] == ["closed", "ajar", "waiting"]
    assert arrows(Other) == [("closed", "pushed", "ajar"), ("ajar", "after_ms(1)", "closed")]
    assert Other.closed.transitions[0].target is Other.ajar


def test_a_transition_added_after_an_unconditional_inherited_one():
    class Base(Machine):
        a = State()
        b = State()
        a.to(b)

    with pytest.raises(DefinitionError, match="can never fire"):

        class Late(Base):
            Base.a.to(Base.b, when=lambda m: True)


def test_a_subclass_runs():
    class Alarmed(Door):
        ringing = State()
        Door.ajar.to(ringing, when=lambda m: True)

    machine = Alarmed()
    with Arrangement([machine], idle_us=0) as arrangement:
        arrangement.run(max_rounds=9)
    assert machine.state_name == "ringing"


def test_mixins_share_ports_variables_and_methods():
    class Ports:
        numbers = Sensor(NUMBER)
        post = Actuator(NUMBER)
        limit: int = 3
        unit: ClassVar[str] = "m"
        other: Final = 4

        def far(self) -> bool:
            return self.limit > 2

    class Walker(Ports, Machine):
        a = State()

    class Runner(Walker):
        speed: float = 1.0

    assert list(Walker.table.sensors) == ["numbers"]
    assert list(Runner.table.actuators) == ["post"]
    assert list(Runner.table.variables) == ["limit", "speed"]


# Without a class statement


def test_define_makes_the_same_model():
    closed, ajar, waiting = State("closed"), State("ajar"), State("waiting", suspend=True)
    closed.on_entry(Door.shut)
    closed.to(ajar, when=Door.pushed)
    ajar.to(closed, after_ms=500)
    cls = define(
        "Door", [closed, ajar, waiting], variables={"opened": (int, 0)}, path="doors/Door.machine"
    )
    assert snapshot(cls) == snapshot(Door)
    assert cls.table.path == "doors/Door.machine"
    assert cls.__name__ == "Door"
    assert cls(opened=3).opened == 3


def test_defined_states_are_no_attributes():
    cls = define("Bundle", [State("load"), State("name", suspend=True)])
    assert cls().name == "Bundle"
    assert not hasattr(cls, "initial")


def test_a_defined_class_can_be_extended():
    parent = define("Bundle", [State("load")])

    class Child(parent):  # type: ignore[misc, valid-type]
        parent.table.initial.on_entry(lambda m: None)

    assert list(Child.table.initial.sections) == ["OnEntry"]
    assert parent.table.initial.sections == {}
