"""What states run is explored as part of their machines: as many states as in real runs."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from typing import Any

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from inner_worlds import DOOR, LOOKING, OUT, PARKED, PLAIN, built, worlds
from llfsm.runtime import Actuator, Machine, Sensor, State, Submachine
from llfsm.runtime.counterexamples import holds, replay, script_of, story_of
from llfsm.runtime.testing import InvariantError, play
from llfsm.runtime.verification import (
    DomainError,
    PredicateError,
    PropertyError,
    UnsupportedError,
    always,
    explore,
    leads_to,
    never,
    reachable,
    verify,
)
from llfsm.runtime.verification.properties import NO_FAILURE
from llfsm.whiteboard.messages.std_msgs import Bool, Int32
from replaying_explorer import replayed
from thoroughness import examples

DOORS = [Bool(data=False), Bool(data=True)]


@pytest.fixture(scope="module")
def _quiet() -> Iterator[None]:
    """Log no failures: there are thousands, on purpose."""
    logging.disable()
    yield
    logging.disable(logging.NOTSET)


HOW = [("again", "runs"), ("in_place", "runs"), ("in_place", "stops")]


@settings(max_examples=examples(30))
@given(world=worlds, how=st.sampled_from(HOW))
@example(world=(PLAIN, LOOKING, PARKED, "middle", []), how=HOW[0])  # it is forgotten at the end
@pytest.mark.filterwarnings("ignore::llfsm.runtime.UnreachableStateWarning")
@pytest.mark.usefixtures("_quiet")
def test_random_machines_have_as_many_states_as_replayed_runs(world: Any, how: Any) -> None:
    outer, asked = built(world, *how)
    explored = explore(
        outer,
        period_ms=10,
        sensors={DOOR: DOORS},
        on_error="suspend",
        suspend=asked,
        max_states=250,
    )
    if not explored.complete:
        return  # too large to be replayed
    found = replayed([outer], period_ms=10, domains={"door": DOORS}, suspend=asked)
    assert (explored.states, explored.transitions) == found


class Drive(Machine):
    """Drives for some turns, and fails if it is told to."""

    to: int = 2
    turns: int = 0
    post = Actuator(OUT, at_suspend=Int32(data=0), at_end=Int32(data=0))
    go, over = State(), State()

    @go.internal
    def _(self) -> None:
        self.turns += 1
        self.post(Int32(data=1))

    go.to(over, when=lambda self: self.turns >= self.to)


class Mission(Machine):
    """Drives twice, and remembers how far."""

    door = Sensor(DOOR, default=Bool())
    far: int = 0
    out = State(runs=lambda self: Drive(to=2))
    home = State(runs=lambda self: Drive(to=self.far))
    rest = State()
    out.to(home, when_done=True)
    home.to(rest, when_done=True)
    home.to(rest, when=lambda self: self.door.data)

    @home.on_entry
    def _(self) -> None:
        self.far = self.out.machine.turns


NAMES = ["Mission", "Mission/Drive", "Mission/Drive.0"]


def test_properties_speak_of_them_by_name() -> None:
    verify(
        Mission,
        never(lambda v: v["Mission/Drive"].loaded and v["Mission/Drive.0"].loaded),
        always(lambda v: v.Mission.state == "out" or not v["Mission/Drive"].loaded),
        always(lambda v: v[OUT].data == 0 or any(v[name].loaded for name in NAMES[1:])),
        reachable(lambda v: v["Mission/Drive.0"].turns == 2),
        leads_to(lambda v: v.Mission.state == "out", lambda v: v.Mission.state == "rest"),
        period_ms=10,
        sensors={DOOR: DOORS},
    )


@pytest.mark.parametrize("on_error", ["stop", "suspend"])
@pytest.mark.parametrize("asked", [["Mission"], ["Mission/Drive"], ["Mission", "Mission/Drive.0"]])
def test_nothing_drives_on_whatever_is_asked_of_them(asked: list[str], on_error: Any) -> None:
    def commands(v: Any, name: str) -> bool:
        return v[name].loaded and not v[name].suspended

    verify(
        Mission,
        always(lambda v: v[OUT].data == 0 or any(commands(v, name) for name in NAMES[1:])),
        never(lambda v: v[OUT].data != 0 and v.Mission.suspended),
        period_ms=10,
        sensors={DOOR: DOORS},
        suspend=asked,
        on_error=on_error,
    )


def test_at_any_time_too() -> None:
    verify(
        Mission,
        always(lambda v: v.Mission.state == "out" or not v["Mission/Drive"].loaded),
        sensors={DOOR: DOORS},
    )


def test_a_counterexample_is_a_run_of_real_machines() -> None:
    with pytest.raises(PropertyError) as raised:
        verify(
            Mission,
            never(lambda v: v["Mission/Drive.0"].turns == 2),
            period_ms=10,
            sensors={DOOR: DOORS},
        )
    text = str(raised.value)
    assert "Mission/Drive.0" in text
    assert "violated after" in text


def test_views_of_runs_show_what_proofs_do() -> None:
    prop = never(lambda v: v.Mission.state == "rest" and v["Mission/Drive.0"].turns == 2)
    space = explore(Mission, period_ms=10, sensors={DOOR: DOORS}, properties=[prop])
    (verdict,) = space.verdicts
    assert verdict.holds is False  # what a machine was is seen after its end, too
    assert verdict.witness is not None
    views = replay(space, verdict.witness)
    assert [view["Mission/Drive.0"].loaded for view in views[:2]] == [False, False]
    assert views[-1]["Mission/Drive.0"].turns == 2
    assert not views[-1]["Mission/Drive.0"].loaded
    assert views[-1]["Mission/Drive.0"].state == "go"  # as at its begin
    with pytest.raises(InvariantError):
        play(
            [Mission],
            script_of(verdict.witness, space),
            invariant=holds(prop),
            unload_accepting=True,
        )


def test_a_failure_that_is_not_handled_is_found() -> None:
    class Breaks(Machine):
        a = State()

        @a.on_entry
        def _(self) -> None:
            raise ValueError("on purpose")

    class Careless(Machine):
        work = State(runs=Breaks)
        over = State()
        work.to(over, when_done=True)

    class Careful(Careless):
        Careless.work.to(Careless.over, when_failed=True)

    verify(Careful, period_ms=10)
    space = explore(Careless, period_ms=10, properties=[NO_FAILURE])
    (verdict,) = space.verdicts
    assert verdict.witness is not None
    story = "\n".join(story_of(space, verdict.witness))
    assert "Careless/Breaks  " in story
    assert "fails in runs: " in story


class Back(Machine):
    """Drives back, if the door is open."""

    door = Sensor(DOOR, default=Bool())
    go, over = State(), State()
    go.to(over, when=lambda self: self.door.data)


MAKERS: dict[bool, type[Machine]] = {False: Drive, True: Back}


class Chooses(Machine):
    """Runs what nothing names."""

    door = Sensor(DOOR, default=Bool())
    opened: bool = False
    wait = State()
    work = State(runs=lambda self: MAKERS[self.opened]())
    over = State()
    wait.to(work, after_ms=10)
    work.to(over, when_done=True)

    @wait.internal
    def _(self) -> None:
        self.opened = self.door.data


class Nested(Machine):
    """Runs itself, less and less deep."""

    depth: int = 2
    count: int = 0
    work, over = State(runs=lambda self: deeper(self)), State()
    work.to(over, when_done=True)

    @over.on_entry
    def _(self) -> None:
        self.count = self.depth


def deeper(machine: Nested) -> Machine:
    return Nested(depth=machine.depth - 1) if machine.depth else Drive(to=1)


class Itself(Machine):
    """Runs itself, which it names."""

    depth: int = 2
    work = State(runs=lambda self: Itself(depth=self.depth - 1) if self.depth else Drive())


@pytest.mark.parametrize("cls", [Chooses, Nested, Itself])
@pytest.mark.parametrize("asked", [[], ["outer"], ["inner"]])
@pytest.mark.usefixtures("_quiet")
def test_what_nothing_names_is_found(cls: type[Machine], asked: list[str]) -> None:
    name = cls.__name__
    inner = f"{name}/Back" if cls is Chooses else f"{name}/{name}/{name}/Drive"
    names = {"outer": name, "inner": inner}
    suspend = [names[each] for each in asked]
    domains: dict[str, Any] = {DOOR: DOORS} if cls is Chooses else {}
    explored = explore(
        cls,
        period_ms=10,
        sensors=domains,
        suspend=suspend,
        on_error="suspend",
        properties=[reachable(lambda v: v[inner].loaded), never(lambda v: v[inner].has_failed)],
    )
    assert [each.holds for each in explored.verdicts] == [True, True]
    explored = explore(cls, period_ms=10, sensors=domains, suspend=suspend, on_error="suspend")
    read = {"door": DOORS} if cls is Chooses else {}
    found = replayed([cls], period_ms=10, domains=read, suspend=suspend)
    assert (explored.states, explored.transitions) == found


def test_a_counterexample_with_what_nothing_names_runs_again() -> None:
    space = explore(
        Chooses,
        period_ms=10,
        sensors={DOOR: DOORS},
        properties=[never(lambda v: v["Chooses/Back"].accepted)],
    )
    witness = space.verdicts[0].witness
    assert witness is not None
    last = replay(space, witness)[-1]
    assert last["Chooses/Back"].accepted
    assert not last["Chooses/Drive"].loaded  # which was never made


def test_names_that_are_of_nothing_are_errors_though_not_all_is_named() -> None:
    how: Any = {"period_ms": 10, "sensors": {DOOR: DOORS}}
    with pytest.raises(DomainError, match="suspend names 'Chooses/Gone', which is not a machine"):
        explore(Chooses, suspend=["Chooses/Gone"], **how)
    with pytest.raises(UnsupportedError, match=r"abstract has 'Chooses/Gone\.x'"):
        explore(Chooses, abstract={"Chooses/Gone.x": abs}, **how)
    with pytest.raises(DomainError, match="sensors has a domain for 'gone', which no machine"):
        explore(Chooses, period_ms=10, sensors={DOOR: DOORS, "gone": DOORS})
    with pytest.raises(PredicateError, match="a slot 'Chooses/Gone'"):
        explore(Chooses, properties=[never(lambda v: v["Chooses/Gone"].loaded)], **how)


def test_what_runs_itself_without_end_fails_as_in_a_run() -> None:
    class Again(Machine):
        work = State(runs=lambda self: Again())

    explored = explore(Again, period_ms=10, properties=[NO_FAILURE])
    assert explored.verdicts[0].holds is False


def test_what_is_known_by_a_name_alone_must_be_among_the_machines() -> None:
    class Names(Machine):
        work = State(runs="Drive")

    with pytest.raises(UnsupportedError, match="work runs 'Drive', which is none of the machines"):
        explore(Names, period_ms=10)
    assert explore([Names, Drive], period_ms=10).complete


def test_two_machines_of_one_name_are_refused() -> None:
    class Twice(Machine):
        one, two = State(runs=lambda self: MAKERS[False]()), State(runs=Drive)
        one.to(two, when_done=True)

    with pytest.raises(UnsupportedError, match="Twice/Drive is the name of what two states run"):
        explore(Twice, period_ms=10)


def test_one_that_could_read_sensors_as_it_is_suspended_is_refused() -> None:
    class Reads(Machine):
        door = Sensor(DOOR)
        seen: bool = False
        a = State(final=False)

        @a.on_suspend
        def _(self) -> None:
            self.seen = self.door is not None

    class Runs(Machine):
        work = State(runs=Reads)

    explore(Runs, period_ms=10, sensors={DOOR: DOORS})
    with pytest.raises(UnsupportedError, match="whose OnSuspend could read sensors"):
        explore(Runs, period_ms=10, sensors={DOOR: DOORS}, suspend=["Runs"])


def test_one_whose_end_reads_no_sensor_is_explored() -> None:
    class Stops(Machine):
        door = Sensor(DOOR)
        stopped: bool = False
        a = State(final=False)

        def stop(self) -> None:
            self.stopped = True

        @a.on_suspend
        def _(self) -> None:
            self.stop()

    class Runs(Machine):
        work = State(runs=Stops)

    verify(
        Runs,
        always(lambda v: v["Runs/Stops"].stopped or not v["Runs/Stops"].suspended),
        period_ms=10,
        sensors={DOOR: DOORS},
        suspend=["Runs"],
    )


def test_what_was_polled_is_no_data() -> None:
    class Keeps(Machine):
        kept: Submachine[Drive] | None = None
        work = State(runs=Drive)

        @work.internal
        def _(self) -> None:
            self.kept = self.work

    with pytest.raises(UnsupportedError, match="only data can be explored"):
        explore(Keeps, period_ms=10)
