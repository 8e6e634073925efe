"""What code loads is explored: as many states as in real runs, with the same names and indices."""

from __future__ import annotations

import itertools
import logging
from collections.abc import Callable, Iterable, Iterator
from typing import Any

import pytest
from hypothesis import event, example, given, settings
from hypothesis import strategies as st

from llfsm.runtime import (
    Actuator,
    ExecutionError,
    Machine,
    Sensor,
    State,
    TimeSlot,
    Timetable,
    UnknownMachineError,
)
from llfsm.runtime.counterexamples import holds, regression_of, replay, script_of
from llfsm.runtime.engine.machine import define
from llfsm.runtime.testing import InvariantError, play
from llfsm.runtime.verification import (
    Member,
    Property,
    UnsupportedError,
    always,
    explore,
    monitor,
    never,
    reachable,
)
from llfsm.runtime.verification.properties import NO_FAILURE
from llfsm.whiteboard import Slot
from llfsm.whiteboard.messages.std_msgs import Bool, Int32
from replaying_explorer import replayed
from thoroughness import examples

DOOR, OUT = Slot("door", Bool), Slot("out", Int32)
DOORS = [Bool(data=False), Bool(data=True)]


@pytest.fixture(scope="module", autouse=True)
def _quiet() -> Iterator[None]:
    """Log no failures: there are thousands, on purpose."""
    logging.disable()
    yield
    logging.disable(logging.NOTSET)


class Worker(Machine):
    """Works for two turns, and leaves."""

    turns: int = 0
    work, done = State(), State()

    @work.internal
    def _(self) -> None:
        self.turns += 1

    work.to(done, when=lambda self: self.turns > 1)


class Keeper(Machine):
    """Stays until the door is open, and notes how often it has rested."""

    door = Sensor(DOOR, default=Bool())
    out = Actuator(OUT, at_end=Int32(data=-1))
    found: int = 0
    stay, gone, rest = State(), State(), State(suspend=True)

    @stay.on_entry
    def _(self) -> None:
        self.out(Int32(data=self.index_of(self.name)))

    @stay.on_suspend
    def _(self) -> None:
        self.out(Int32(data=7))

    @rest.on_entry
    def _(self) -> None:
        self.found = min(self.found + 1, 2)

    stay.to(gone, when=lambda self: self.door.data)


class Sender(Machine):
    """Loads a worker, and leaves at once."""

    send, gone = State(), State()

    @send.on_entry
    def _(self) -> None:
        self.load(Worker, variables={"turns": 1})

    send.to(gone)


CLASSES: list[type[Machine]] = [Worker, Keeper, Sender]
NAMES = ["Worker", "Worker.0", "Keeper", "Sender", "X", "A", "B"]
names = st.sampled_from(NAMES)
actions = st.one_of(
    st.tuples(
        st.just("load"), st.integers(0, 2), st.sampled_from([None, None, "X"]), st.booleans()
    ),
    st.tuples(
        st.sampled_from(["unload", "suspend", "restart", "abandon", "index", "running"]), names
    ),
    st.tuples(st.sampled_from(["number", "at 1", "at 2"])),
)
loaders = st.fixed_dictionaries(
    {
        "actions": st.lists(actions, min_size=1, max_size=3),
        "most": st.integers(1, 2),
        "waits": st.sampled_from(["", "door", "time", "out"]),
    }
)


def act(machine: Any, action: Any) -> None:
    """Do an action, and note what comes of it, or that there is no such machine."""
    kind, *rest = action
    try:
        if kind == "load":
            number, name, suspended = rest
            if machine.most:
                machine.most -= 1
                load = machine.load_suspended if suspended else machine.load
                machine.found = load(CLASSES[number], name=name)
        elif kind == "number":
            machine.found = machine.number_of_machines
        elif kind == "index":
            machine.found = machine.index_of(*rest)
        elif kind == "running":
            machine.found = int(machine.is_running(*rest))
        elif kind.startswith("at"):
            machine.found = len(machine.name_of(int(kind[-1])))
        else:
            getattr(machine, kind)(*rest)
    except UnknownMachineError:
        machine.found = -1


def loader(name: str, spec: Any) -> type[Machine]:
    states = [State(f"S{n}") for n in range(len(spec["actions"]))]
    after = [*states[1:], states[0] if len(states) > 1 else State("END")]
    for state, target, action in zip(states, after, spec["actions"], strict=True):
        state.on_entry(acting(action))
        if spec["waits"] == "time":
            state.to(target, after_ms=10)
        elif spec["waits"] == "out":
            state.to(target, when=lambda machine: machine.out is not None)
        elif spec["waits"]:
            state.to(target, when=lambda machine: machine.door.data)
        else:
            state.to(target)
    ports: dict[str, Any] = {"door": Sensor(DOOR, default=Bool()), "out": Sensor(OUT)}
    ports["post"] = Actuator(OUT, at_end=Int32(data=-2))
    own = {"most": (int, spec["most"]), "found": (int, -2)}
    return define(name, list(dict.fromkeys([*states, *after])), variables=own, attributes=ports)


def acting(action: Any) -> Callable[[Any], None]:
    return lambda machine: act(machine, action)


KEEPS = {"actions": [("load", 1, None, False), ("abandon", "Keeper")], "most": 1, "waits": ""}
AFTER = {"actions": [("load", 0, None, False), ("load", 1, None, False)], "most": 2, "waits": ""}
FILLS = AFTER | {"actions": [("load", 0, None, False), ("unload", "Worker"), ("load", 1, None, 0)]}
LEAVES = AFTER | {"actions": [("load", 1, None, False), ("load", 0, None, False)], "waits": "door"}
REPLACES = {"actions": [("load", 1, "X", False), ("running", "B")], "most": 1, "waits": "out"}
NOTES = {"actions": [("running", "X"), ("at 1",)], "most": 1, "waits": "out"}


@settings(max_examples=examples(20))
@example(front=None, first=KEEPS, second=None)
@example(front=None, first=AFTER, second=None)
@example(front=None, first=FILLS, second=None)
@example(front=None, first=LEAVES, second=AFTER)
@example(front=Keeper, first=REPLACES, second=NOTES)
@given(front=st.sampled_from([None, *CLASSES]), first=loaders, second=st.none() | loaders)
@pytest.mark.filterwarnings("ignore::llfsm.runtime.UnreachableStateWarning")
def test_random_loaders_have_as_many_states_as_replayed_runs(
    front: type[Machine] | None, first: Any, second: Any
) -> None:
    machines = [loader("A", first), *([loader("B", second)] if second else [])]
    machines = [*([front] if front else []), *machines]
    how: dict[str, Any] = {"period_ms": 10, "sensors": {DOOR: DOORS}, "on_error": "suspend"}
    try:
        explored = explore(machines, max_states=250, **how)
    except UnsupportedError as error:
        if "name of its own" not in str(error) and "add it" not in str(error):
            raise
        event("refused")
        return
    if not explored.complete:
        return  # too large to be replayed
    event(f"{len(explored.found.loaded)} loaded")
    known: set[tuple[str, int]] = set()

    def look(seats: Iterable[Any]) -> None:
        known.update((seat.name, getattr(seat.machine, "found", -2)) for seat in seats)

    found = replayed(machines, period_ms=10, domains={"door": DOORS}, kept=["out"], each_state=look)
    assert (explored.states, explored.transitions) == found
    named = {name: number for name, number in known if number > -2}
    pairs = list(itertools.product(named, range(-1, 10)))
    asked = [has_found(*pair) for pair in pairs]
    verdicts = explore(machines, properties=asked, **how).verdicts
    seen = {pair for pair, verdict in zip(pairs, verdicts, strict=True) if verdict.holds}
    assert seen == {pair for pair in known if pair[1] > -2}


def has_found(name: str, number: int) -> Property:
    return reachable(lambda v: v[name].found == number)


class Crew(Machine):
    """Loads two keepers, one after the other, and unloads the first."""

    begin, more, less, over = State(), State(), State(), State()
    begin.to(more, after_ms=10)
    more.to(less, after_ms=10)
    less.to(over, after_ms=10)

    @begin.on_entry
    @more.on_entry
    def _(self) -> None:
        self.load(Keeper)

    @less.on_entry
    def _(self) -> None:
        self.unload("Keeper")


HOW: dict[str, Any] = {"period_ms": 10, "sensors": {DOOR: [Bool(data=False)]}}


def test_properties_speak_of_them_by_name_before_they_are_there() -> None:
    space = explore(
        Crew,
        **HOW,
        properties=[
            never(lambda v: v.Crew.state == "begin" and v["Keeper.0"].loaded, "later"),
            reachable(lambda v: v.Keeper.loaded and v["Keeper.0"].loaded, "both"),
            always(lambda v: v[OUT] is None or v[OUT].data < 3, "three"),
            reachable(lambda v: v[OUT].data == -1, "it ends"),
        ],
    )
    assert [verdict.holds for verdict in space.verdicts] == [True, True, True, True]


BOTH = never(lambda v: v.Keeper.loaded and v["Keeper.0"].loaded, "both")


def test_a_counterexample_runs_again_and_becomes_a_test() -> None:
    space = explore(Crew, **HOW, properties=[BOTH])
    witness = space.verdicts[0].witness
    assert witness is not None
    views = replay(space, witness)
    assert not views[0]["Keeper.0"].loaded
    assert views[-1]["Keeper.0"].loaded
    text = regression_of(space, witness, f"{__name__}:BOTH", folder=None)
    assert "holds(BOTH, loads=[Keeper, Member(Keeper, name='Keeper.0')])" in text
    invariant = holds(BOTH, loads=[Keeper, Member(Keeper, name="Keeper.0")])
    with pytest.raises(InvariantError, match="both"):
        play([Crew], script_of(witness, space), invariant=invariant)


def test_a_timetable_gives_them_their_turns_and_knows_their_names() -> None:
    slots = [
        TimeSlot(name, 2_000 * n, 1_000) for n, name in enumerate(["Keeper.0", "Crew", "Keeper"])
    ]
    how: dict[str, Any] = {"sensors": HOW["sensors"]}
    table = Timetable(slots, 10_000)
    in_order = never(lambda v: v[OUT].data == 2 and not v["Keeper.0"].loaded, "it is there")
    space = explore(Crew, timetable=table, properties=[in_order], **how)
    assert space.verdicts[0].holds
    assert space.complete
    failing = explore(Crew, timetable=Timetable(slots[1:], 10_000), properties=[NO_FAILURE], **how)
    witness = failing.verdicts[0].witness
    assert witness is not None
    with pytest.raises(ExecutionError, match=r"Keeper\.0"):
        replay(failing, witness)


class Chief(Machine):
    """Loads a worker and one that sends another, one after the other."""

    begin, more, over = State(), State(), State()
    begin.to(more, after_ms=10)
    more.to(over, after_ms=10)

    @begin.on_entry
    def _(self) -> None:
        self.load(Worker)

    @more.on_entry
    def _(self) -> None:
        self.load(Sender)


class Outer(Machine):
    """Has an inner machine, which loads others beside it."""

    door = Sensor(DOOR, default=Bool())
    work, over = State(runs=Chief), State()
    work.to(over, when=lambda self: self.door.data)


def test_what_an_inner_machine_loads_is_an_outermost_one() -> None:
    found = replayed([Outer], period_ms=10, domains={"door": DOORS})
    explored = explore(Outer, period_ms=10, sensors={DOOR: DOORS}, on_error="suspend")
    assert (explored.states, explored.transitions) == found
    assert {each.name for each in explored.found.loaded} == {"Sender", "Worker"}


def loading(action: Callable[[Any], object]) -> type[Machine]:
    """Make a machine that does this on entry, and again after a while."""
    first, second = State("FIRST"), State("SECOND")
    first.on_entry(lambda machine: action(machine) and None)
    first.to(second, after_ms=20)
    second.to(first)
    return define("Loading", [first, second])


INSTANCE = Worker()


@pytest.mark.parametrize(
    ("action", "text"),
    [
        (lambda m: m.load(INSTANCE), "loads a Worker as a machine that is made already"),
        (lambda m: m.load("Worker"), "loads 'Worker', which is the name of none of the machines"),
        (lambda m: m.load(Keeper), "loads more and more machines, such as Keeper"),
        (lambda m: m.abandon("Reader"), "abandons Reader, whose OnSuspend or suspend state could"),
        (
            lambda m: m.load([Worker, Sender][m.number_of_machines % 2], name="One"),
            "loads One, and what is called so has another index, class, path or slots",
        ),
    ],
)
def test_what_cannot_be_explored_is_refused_by_name(action: Any, text: str) -> None:
    class Reader(Machine):
        door = Sensor(DOOR, default=Bool())
        idle = State()
        idle.to(idle, when=lambda self: self.door.data)

        @idle.on_suspend
        def _(self) -> None:
            assert not self.door.data

    with pytest.raises(UnsupportedError, match=text):
        explore([loading(action), Reader], **HOW)


def test_a_monitor_loads_nothing() -> None:
    watching = loading(lambda machine: machine.load(Worker))
    with pytest.raises(UnsupportedError, match="asks to load Worker: a monitor must not act"):
        explore(Crew, **HOW, properties=[monitor(watching, watching.table.states[1])])
