"""A machine as messages: what can be drawn of it elsewhere is what can be drawn of it here."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace

from llfsm.machines import RosWallTurttleBot
from llfsm.runtime import Arrangement, DefinitionError, Machine, ManualClock, Sensor, State, define
from llfsm.runtime.bundles import load_bundle
from llfsm.runtime.drawing import Diagram, arrange
from llfsm.runtime.presence.published import definition_of, table_of, variables_of
from llfsm.whiteboard import Slot, Whiteboard
from llfsm.whiteboard.messages.llfsm import (
    VIEWER,
    DefinedBox,
    DefinedSection,
    DefinedState,
    DefinedTransition,
    InnerDefinition,
    MachineDefinition,
    MachineVariables,
    VariableValue,
    Viewer,
    definition_slot,
    variables_slot,
)
from llfsm.whiteboard.messages.std_msgs import Bool, String

BUNDLES = sorted((Path(__file__).parents[3] / "machines").glob("*.machine"))


class Odd(Machine):
    """Have variables of every kind."""

    number: int = 3
    large: int = 2**70
    part: float = 0.5
    flag: bool = True
    text: str = "a" * 300
    nothing: None = None
    things: list[int] = [1, 2]  # noqa: RUF012  a variable: each machine has its own
    hostile: Any = None
    unsaid: str = "\ud800"

    a = State()
    b = State()
    a.to(b, when=lambda m: False)

    @a.on_entry
    def _(self) -> None:
        self.hostile = _Hostile()


class One(Machine):
    a, b = State(), State()
    a.to(b, after_ms=1)


class Two(Machine):
    a, b = State(runs=[One]), State(runs=One)
    a.to(b, when_done=True)


class Outer(Machine):
    a, b = State(runs=[Two, One]), State(runs=lambda self: Two() if self.name else Outer())
    a.to(b, when_failed=True)


class _Hostile:
    def __repr__(self) -> str:
        raise RuntimeError("no")


@pytest.mark.parametrize("sections", [None, True, False])
@pytest.mark.parametrize("path", BUNDLES, ids=lambda path: path.stem)
def test_a_table_made_of_a_definition_is_drawn_as_the_machine_is(
    path: Path, sections: bool | None
) -> None:
    table = load_bundle(path).table
    again = table_of(definition_of(table))
    assert arrange(again, sections=sections) == arrange(table, sections=sections)


def test_a_class_is_drawn_as_it_is_too() -> None:
    table = RosWallTurttleBot.table
    assert arrange(table_of(definition_of(table)), sections=True) == arrange(table, sections=True)


def test_what_states_run_is_drawn_as_it_is_too() -> None:
    table = Outer.table
    again = table_of(definition_of(table))
    drawn = arrange(again, unfold=lambda _: None)
    assert arrange(again) == arrange(table)
    names = [
        (each.machine, [i.machine for b in each.boxes for i in b.inner]) for each in _in(drawn)
    ]
    assert names == [("Two", ["One", "One.0"]), ("One", []), ("Two.0", ["One", "One.0"])]
    assert arrange(table_of(definition_of(table, inner=False)), unfold=lambda _: None) == arrange(
        table
    )
    inner = arrange(Two.table, unfold=lambda _: None)
    assert arrange(table_of(definition_of(Two.table)), unfold=lambda _: None) == inner


def _in(diagram: Diagram) -> Iterator[Diagram]:
    for box in diagram.boxes:
        yield from box.inner


def test_a_section_of_which_only_the_text_is_known_is_not_run() -> None:
    table = table_of(definition_of(Odd.table))
    with pytest.raises(TypeError, match="cannot be run"):
        table.states[0].sections["OnEntry"](None)


def _reported(*states: DefinedState) -> MachineDefinition:
    return MachineDefinition("bad", states)


def _inside(*names: str, number: int = 0, states: int = 1, runs: str = "") -> MachineDefinition:
    """Define a machine, of which a state runs something, and inner machines."""
    each = tuple(DefinedState(str(n)) for n in range(states))
    outer = DefinedState("a", (DefinedSection("Runs", runs),) if runs else ())
    inner = (InnerDefinition(name, "a", number, "", each) for name in names)
    return MachineDefinition("bad", (outer,), "", tuple(inner))


@pytest.mark.parametrize(
    ("reported", "what"),
    [
        (_reported(), "no states"),
        (_reported(DefinedState("a"), DefinedState("a")), "two of the same name"),
        (_reported(DefinedState("a", (), (DefinedTransition("z", ""),))), "not a state of it"),
        (
            _reported(DefinedState("a", box=DefinedBox(float("nan"), 0, 1, 1))),
            "impossible coordinates",
        ),
        (_reported(DefinedState("a", box=DefinedBox(1e300, 0, 1, 1))), "impossible coordinates"),
        (_reported(*(DefinedState(str(i)) for i in range(251))), "251 states"),
        (_reported(DefinedState("x" * 1_000_001)), "characters"),
        (_inside("Arm"), "no state of it runs 'Arm'"),
        (_inside("Arm", "Arm", runs="Arm"), "no state of it runs 'Arm'"),  # twice
        (_inside("Arm/Wheel", runs="Arm"), "no state of it runs 'Arm/Wheel'"),
        (_inside("Arm", number=1, runs="Arm"), "no state of it runs 'Arm'"),
        (_inside("Arm", number=-1, runs="Arm"), "no state of it runs 'Arm'"),
        (_inside("Arm", states=250, runs="Arm"), "251 states"),
        (_inside(*(f"M{i}" for i in range(51)), runs="Arm"), "51 inner machines"),
    ],
)
def test_a_definition_that_cannot_be_drawn_says_why(reported: MachineDefinition, what: str) -> None:
    with pytest.raises(DefinitionError, match=what):
        table_of(reported)


def test_a_path_of_some_other_length_is_left_aside() -> None:
    reported = DefinedState(
        "a", (), (DefinedTransition("a", "", (1.0, 2.0)),), DefinedBox(0, 0, 9, 9)
    )
    table = table_of(_reported(reported))
    assert table.layout is not None
    assert table.layout.transitions == {"a": ()}


def test_variables_are_reported_whatever_they_are() -> None:
    board = Whiteboard.local()
    arrangement = Arrangement([Odd], whiteboard=board, clock=ManualClock())
    arrangement.round()
    reported = {v.name: v.value for v in variables_of(arrangement.machine("Odd")).variables}
    assert reported["number"] == 3
    assert reported["part"] == 0.5
    assert reported["flag"] is True
    assert reported["nothing"] is None
    assert reported["things"] == "[1, 2]"
    assert str(reported["large"]).startswith("118059")
    assert reported["text"] == "a" * 199 + "…"
    assert str(reported["hostile"]).startswith("<_Hostile instance")
    assert reported["unsaid"] == "'\\ud800'"


class Reader(Machine):
    """Read what a camera and a button post; there are no variables."""

    button = Sensor(Slot("button", Bool))
    text = Sensor(Slot("text", String), default=String())

    a = State()
    b = State()
    a.to(b, after=1)


def _reported_of(machine: type[Machine], slot: Slot[String]) -> MachineVariables:
    """Return what is published of a machine that runs while somebody looks."""
    board = Whiteboard.local()
    board.add_message(slot, String(data="a" * 300))
    arrangement = Arrangement([machine], whiteboard=board, clock=ManualClock())
    arrangement.attach(lambda event: board.add_message(VIEWER, Viewer(1)))
    arrangement.run()
    reported = board.get_message(variables_slot(machine.__name__))
    assert reported is not None
    return reported


def test_sensors_are_told_apart_as_of_the_last_snapshot() -> None:
    reported = _reported_of(Reader, Reader.text.slot)
    assert reported.variables == ()
    button, text = reported.sensors
    assert button == VariableValue("button", None)
    assert text.name == "text"
    assert str(text.value).startswith("String(data='aaa")
    assert len(str(text.value)) <= 200


def test_what_is_too_much_is_left_out() -> None:
    names = [f"sensor_{i}" for i in range(200)]
    ports = {name: Sensor(Slot("text", String)) for name in names}
    states = [State("a"), State("b")]
    states[0].to(states[1], after=1)
    machine = define("Many", states, variables={"n": (int, 0)}, attributes=ports)
    reported = _reported_of(machine, Slot("text", String))
    assert reported.variables == (VariableValue("n", 0),)
    assert [each.name for each in reported.sensors] == names[: len(reported.sensors)]
    assert 5 < len(reported.sensors) < 200


def test_a_machine_reports_once_what_it_consists_of() -> None:
    board = Whiteboard.local()
    Arrangement([Odd], whiteboard=board, clock=ManualClock()).run(max_rounds=50)
    slot = board[definition_slot("Odd")]
    assert slot.count == 1
    assert slot.get() == definition_of(Odd.table)


def test_a_machine_with_too_much_code_is_reported_without_it() -> None:
    states = [State("a"), State("b")]
    states[0].to(states[1], label="x" * 30_000, when=lambda m: False)
    states[0].on_entry(long := _long())
    board = Whiteboard.local()
    machine = define("Large", states)
    Arrangement([machine], whiteboard=board, clock=ManualClock()).run(max_rounds=1)
    reported = board.get_message(definition_slot("Large"))
    assert long is not None
    assert reported == definition_of(machine.table, sections=False)


def _long() -> Any:
    namespace: dict[str, Any] = {}
    import linecache

    text = "def long(self):\n" + "    pass  # and so on\n" * 500
    linecache.cache["<long>"] = (len(text), None, text.splitlines(True), "<long>")
    exec(compile(text, "<long>", "exec"), namespace)
    return namespace["long"]


def test_variables_are_reported_ten_times_a_second_and_only_while_somebody_looks() -> None:
    board, clock = Whiteboard.local(), ManualClock()
    counts = []

    class Watched(Machine):
        n: int = 0
        a = State()
        b = State()

        @a.internal
        def _(self) -> None:
            self.n += 1
            if self.n == 100:
                board.add_message(VIEWER, Viewer(1))
            counts.append(board[variables_slot("Watched")].count)

        a.to(b, after=10)

    Arrangement([Watched], whiteboard=board, clock=clock).run()
    assert counts[99] == 0
    assert counts[-1] in (20, 21)  # for two seconds
    last = board.get_message(variables_slot("Watched"))
    assert last is not None
    assert replace(last.variables[0], value=0).name == "n"
