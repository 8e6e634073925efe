"""Machines that are kept in a file go on where they were."""

from __future__ import annotations

import logging
import math
import sys
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from enum import Enum
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from inner_worlds import DOOR, LOOKING, OUT, PARKED, PLAIN, built, worlds
from llfsm.runtime import (
    Actuator,
    Arrangement,
    KeepError,
    Machine,
    ManualClock,
    Reason,
    State,
    Status,
    Submachine,
    variable,
)
from llfsm.runtime.bundles import Bundle, BundleState, load_bundle, write_bundle
from llfsm.runtime.engine.events import Event, RoundEnd
from llfsm.runtime.engine.seat import Seat
from llfsm.runtime.keeping import keep_in
from llfsm.whiteboard.local import LocalBoard
from llfsm.whiteboard.messages.std_msgs import Bool, Int32
from thoroughness import examples


@pytest.fixture(autouse=True)
def _quiet() -> Iterator[None]:
    """Log no failures: there are thousands, on purpose."""
    logging.disable()
    yield
    logging.disable(logging.NOTSET)


class Process:
    """Machines in a process, which may be killed and started again."""

    def __init__(self, *machines: type[Machine], file: Path | None = None, **options: Any):
        self.machines = machines
        self.file = file
        self.options = {"on_error": "suspend"} | options
        self.board = LocalBoard()
        self.now_ns = 0
        self.went_on: list[bool] = []
        self.requests: list[tuple[str, int]] = []  # to be made as the next round ends
        self.start()

    def start(self) -> None:
        self.clock = ManualClock(self.now_ns)
        self.arrangement = Arrangement(
            self.machines,
            whiteboard=self.board,
            clock=self.clock,
            observers=[self.ask],
            **self.options,
        )
        self.ends = ExitStack()
        if self.file is not None:
            self.went_on.append(self.ends.enter_context(keep_in(self.file, self.arrangement)))

    def ask(self, event: Event) -> None:
        if isinstance(event, RoundEnd):
            while self.requests and (names := sorted(self.arrangement.roster.named)):
                request, number = self.requests.pop()
                getattr(self.arrangement, request)(names[number % len(names)])

    def kill(self) -> None:
        """End without anything that a process which ends by itself would do."""
        self.ends.close()  # which writes nothing

    def turn(self, number: int = 1, ms: int = 10) -> None:
        for _ in range(number):
            self.clock.advance(ms=ms)
            self.now_ns = self.clock.now_ns()
            self.arrangement.round()

    @property
    def standing(self) -> dict[str, Any]:
        """What can be seen of the machines, and of those inside them."""
        return {
            seat.name: (
                seat.current.name,
                seat.remembered.name if seat.suspended else "",
                getattr(seat.machine, "count", None),
                seat.failure is not None,
                seat.accepted,
            )
            for seat in self.arrangement.roster
        }


steps = st.lists(
    st.one_of(
        st.tuples(st.just("turn"), st.sampled_from([1, 10, 25])),
        st.tuples(st.just("door"), st.booleans()),
        st.tuples(st.sampled_from(["suspend", "resume", "restart"]), st.integers(0, 3)),
        st.just(("kill", 0)),
    ),
    max_size=30,
)


@settings(max_examples=examples(150), deadline=None)
@given(world=worlds, steps=steps, keeps=st.booleans())
@example(
    world=(PLAIN, LOOKING, PARKED, "middle", []),
    steps=[("turn", 1), ("turn", 1), ("door", True), ("turn", 1), ("kill", 0), ("turn", 10)] * 2,
    keeps=False,
)
@pytest.mark.filterwarnings("ignore::llfsm.runtime.UnreachableStateWarning")
def test_nobody_sees_that_machines_were_killed_if_all_states_go_on_in_place(
    world: Any, steps: list[tuple[str, Any]], keeps: bool
) -> None:
    assume(world[3] != "unnamed")  # classes that are in no module, and that nothing names
    outer, _ = built(world, resume="in_place")
    with TemporaryDirectory() as folder, ExitStack() as ends:
        lives = Process(outer, unload_accepting=not keeps)
        killed = Process(outer, file=Path(folder, "kept"), unload_accepting=not keeps)
        ends.callback(killed.kill)
        for step, argument in steps:
            if step == "kill":
                killed.kill()
                killed.start()
                continue
            for process in (lives, killed):
                if step == "turn":
                    process.turn(ms=argument)
                elif step == "door":
                    process.board.add_message(DOOR, Bool(data=argument))
                else:
                    process.requests.append((step, argument))
            if step == "turn":
                assert killed.standing == lives.standing
                assert killed.board.get_message(OUT) == lives.board.get_message(OUT)


class Pump(Machine):
    """Gives a dose a second, and never one twice."""

    given: int = 0
    rests: int = 0
    tube = Actuator(OUT, at_end=Int32(data=0))
    give = State(resume="in_place")
    rest = State()
    give.to(rest, after_ms=1000)
    rest.to(give, after_ms=500)

    @give.on_entry
    def _(self) -> None:
        self.given += 1
        self.tube(Int32(data=1))

    @rest.on_entry
    def _(self) -> None:
        self.rests += 1


@pytest.mark.parametrize(("ms", "given", "rests"), [(400, 1, 0), (1400, 1, 2), (1600, 2, 1)])
def test_a_state_decides_whether_it_is_entered_again(
    tmp_path: Path, ms: int, given: int, rests: int
) -> None:
    process = Process(Pump, file=tmp_path / "kept")
    process.turn(ms // 10)
    process.kill()
    process.start()
    process.turn()
    pump = process.arrangement.machine("Pump")
    assert isinstance(pump, Pump)
    assert (pump.given, pump.rests) == (given, rests)
    assert process.went_on == [False, True]
    process.kill()


@pytest.mark.parametrize(("clock", "left"), [("runs", False), ("stops", True)])
def test_the_clock_of_a_state_may_stop_meanwhile(tmp_path: Path, clock: Any, left: bool) -> None:
    class Waits(Machine):
        first, last = State(resume="in_place", clock=clock), State()
        first.to(last, after_ms=1000)

    process = Process(Waits, file=tmp_path / "kept")
    process.turn(50)
    process.kill()
    process.now_ns += 10**9
    process.start()
    process.turn()
    assert (process.arrangement.states().get("Waits") == "first") is left
    process.turn(49)
    assert (process.arrangement.states().get("Waits") == "first") is left
    process.turn(3)
    assert process.arrangement.states().get("Waits") != "first"
    process.kill()


class Brakes(Machine):
    """Counts how often it was suspended in its first state."""

    braked: int = 0
    first, last = State(), State(final=False)
    first.to(last, after_ms=25)

    @first.on_suspend
    def _(self) -> None:
        self.braked += 1


@pytest.mark.parametrize("resumed", [False, True])
def test_one_that_was_loaded_suspended_stands_where_it_was(tmp_path: Path, resumed: bool) -> None:
    process = Process(file=tmp_path / "kept", start_suspended=[Brakes])
    process.turn()
    process.arrangement.resume("Brakes")
    process.turn(5)
    if not resumed:
        process.arrangement.suspend("Brakes")
        process.turn()
    process.kill()
    process.start()
    process.turn()
    machine: Any = process.arrangement.machine("Brakes")
    seat = process.arrangement.roster.find("Brakes")
    assert machine.braked == 1  # as it was loaded
    assert seat.remembered.name == "last"
    assert seat.suspended is not resumed
    assert seat.arrival().source == ""
    process.kill()


class Colour(Enum):
    RED = "red"


class Holds(Machine):
    """Has variables of many kinds."""

    number: float = math.nan
    message: Int32 | None = None
    pairs: tuple[tuple[int, str], ...] = ()
    colours: set[Colour] = set()  # noqa: RUF012  # a default of each machine's own
    raw: bytes = b""
    lists: dict[str, list[float]] = {}  # noqa: RUF012
    cache: object = variable(None, kept=False)
    work: Submachine[Pump] | None = None
    on = State(final=False)


def test_variables_come_back_as_they_were(tmp_path: Path) -> None:
    process = Process(Holds, file=tmp_path / "kept")
    process.turn()
    machine: Any = process.arrangement.machine("Holds")
    machine.number, machine.message, machine.pairs = math.inf, Int32(data=3), ((1, "a"),)
    machine.colours, machine.raw, machine.lists = {Colour.RED}, b"\0\xff", {"x": [1.0]}
    machine.cache = lambda: None
    machine.work = process.arrangement.call_machine(Pump)
    process.turn()
    process.kill()
    process.start()
    again: Any = process.arrangement.machine("Holds")
    assert (again.cache, again.work) == (None, None)
    for name in ("number", "message", "pairs", "colours", "raw", "lists"):
        assert getattr(again, name) == getattr(machine, name)
    assert process.arrangement.roster.named.keys() == {"Holds"}
    process.kill()


@pytest.mark.parametrize("value", [lambda: None, [(1, 2)], {1, 2}, 2**70, object()])
def test_a_value_that_would_not_come_back_is_refused_before_anything_runs(
    tmp_path: Path, value: Any
) -> None:
    class Any_(Machine):  # noqa: N801
        thing: Any = None
        on = State(final=False)

    arrangement = Arrangement([Any_(thing=value)], clock=ManualClock())
    with (
        pytest.raises(KeepError, match=r"Any_\.thing, a .*thing: \.\.\. = variable\(\.\.\., kept"),
        keep_in(tmp_path / "kept", arrangement),
    ):
        pass
    assert [*tmp_path.iterdir()] == []


def test_one_that_has_accepted_stays_so_and_all_begin_anew_once_all_have(tmp_path: Path) -> None:
    class Short(Machine):
        first, last = State(), State()
        first.to(last)

    class Long(Machine):
        first, last = State(resume="in_place"), State()
        first.to(last, after_ms=1000)

    process = Process(Short, Long, file=tmp_path / "kept")
    process.turn(10)
    process.kill()
    process.start()
    assert process.arrangement.states() == {"Long": "first"}
    process.kill()
    process.start()
    assert process.arrangement.states() == {"Long": "first"}
    assert process.arrangement.run() is Reason.ACCEPTING
    process.kill()
    process.start()
    assert process.went_on == [False, True, True, False]
    assert process.arrangement.states() == {"Short": "first", "Long": "first"}
    process.kill()


def test_one_that_ends_as_it_is_asked_to_begins_anew(tmp_path: Path) -> None:
    class Obeys(Machine):
        count: int = 0
        first, last = State(), State()
        first.to(last, when=lambda self: self.stopping)

        @first.internal
        def _(self) -> None:
            self.count += 1

    class Stays(Machine):
        count: int = 0
        first = State(final=False)

        @first.internal
        def _(self) -> None:
            self.count += 1

    process = Process(Obeys, Stays, file=tmp_path / "kept")
    process.turn(3)
    process.arrangement.stop()
    assert process.arrangement.run(grace_s=0.05) is Reason.STOPPED
    counted = getattr(process.arrangement.kernel, "rounds", 0)
    process.kill()
    process.start()
    obeys, stays = process.arrangement.machines
    assert isinstance(obeys, Obeys)
    assert isinstance(stays, Stays)
    assert (obeys.state_name, obeys.count, stays.count) == ("first", 0, counted)
    process.kill()


def test_a_failed_machine_waits_as_before(tmp_path: Path) -> None:
    class Fails(Machine):
        bad: bool = True
        first = State(final=False)

        @first.on_entry
        def _(self) -> None:
            if self.bad:
                raise ValueError("on purpose")

    process = Process(Fails, file=tmp_path / "kept")
    process.turn(2)
    before: Seat = process.arrangement.roster.find("Fails")
    process.kill()
    process.start()
    after = process.arrangement.roster.find("Fails")
    assert before.failure is not None
    assert after.failure is not None
    assert str(after.failure.error) == str(before.failure.error)
    assert process.arrangement.status("Fails") is Status.SUSPENDED
    process.turn()
    process.arrangement.resume("Fails")
    process.arrangement.machine("Fails").bad = False  # type: ignore[attr-defined]
    process.turn()
    assert process.arrangement.status("Fails") is Status.RUNNING
    process.kill()


def other_machines() -> list[tuple[list[type[Machine]], str]]:
    """Machines that cannot go on where a pump was, and what is wrong."""
    body = {"given": 0, "rests": 0, "__annotations__": {"given": int, "rests": int}}
    path = Pump.table.path

    def named(state: str, **more: Any) -> type[Machine]:
        first, last = State(state), State("last")
        first.to(last, after_ms=1)
        return type(Machine)("Pump", (Machine,), _body(more), states=[first, last], path=path)

    def _body(more: dict[str, Any]) -> Any:
        made = type(Machine).__prepare__("Pump", (Machine,))
        made.update(body | more)
        return made

    return [
        ([Holds], "has a machine Pump, which is not run"),
        ([named("other")], "has Pump in give, a state that it has no more"),
        ([named("give", __annotations__={"given": int})], "a variable 'rests', which Pump has no"),
        (
            [named("give", __annotations__={"given": str, "rests": int}, given="")],
            "has another type of Pump.given: Expected `str`, got `int`",
        ),
    ]


@pytest.mark.parametrize(("machines", "what"), other_machines(), ids=lambda each: str(each)[:20])
def test_a_file_of_other_machines_is_refused(
    tmp_path: Path, machines: list[type[Machine]], what: str
) -> None:
    process = Process(Pump, file=tmp_path / "kept")
    process.turn(3)
    process.kill()
    before = (tmp_path / "kept").read_bytes()
    arrangement = Arrangement(machines, whiteboard=LocalBoard(), clock=ManualClock())
    with pytest.raises(KeepError) as caught, keep_in(tmp_path / "kept", arrangement):
        pass
    assert what in str(caught.value)
    assert str(caught.value).endswith("or remove it to begin anew")
    assert (tmp_path / "kept").read_bytes() == before


def test_variables_that_are_new_have_their_defaults(tmp_path: Path) -> None:
    process = Process(Pump, file=tmp_path / "kept")
    process.turn(3)
    process.kill()

    class More(Pump, path=Pump.table.path):
        more: int = 7

    arrangement = Arrangement([], whiteboard=LocalBoard(), clock=ManualClock(30_000_000))
    arrangement.load(More, name="Pump")
    with keep_in(tmp_path / "kept", arrangement):
        pump: Any = arrangement.machine("Pump")
        assert (pump.given, pump.more) == (1, 7)


def test_their_folder_may_be_another_one(tmp_path: Path) -> None:
    for folder in ("old", "new"):
        bundle = Bundle("Lamp", (BundleState("On", final=False),))
        write_bundle(bundle, tmp_path / folder / "Lamp.machine")
    for folder, goes_on in (("old", False), ("new", True)):
        lamp = load_bundle(tmp_path / folder / "Lamp.machine")
        arrangement = Arrangement([lamp], clock=ManualClock())
        with keep_in(tmp_path / "kept", arrangement) as found:
            assert found is goes_on
            arrangement.round()


def test_a_round_that_changes_nothing_writes_nothing(tmp_path: Path) -> None:
    process = Process(Holds, file=tmp_path / "kept")
    process.turn(2)
    before = (tmp_path / "kept").stat().st_mtime_ns
    process.turn(100)
    assert (tmp_path / "kept").stat().st_mtime_ns == before
    process.kill()


def test_variables_of_bundles_and_subclasses_keep_what_was_said_of_them() -> None:
    class Child(Holds):
        cache = 3

    assert not Child.table.variables["cache"].kept
    assert Child.table.variables["cache"].default == 3
    with suppress(AttributeError):
        assert Child().cache == 3  # type: ignore[comparison-overlap]


class Far(Machine):
    steps: int
    go = State(final=False)


class Near(Machine):
    go = State(final=False)


HIDDEN = {False: lambda: Far(steps=3), True: Near}


class Chooses(Machine):
    """Runs one machine, and would run another one now, for reasons that nothing names."""

    near: bool = False
    work = State(runs=lambda self: HIDDEN[self.near](), final=False)

    @work.internal
    def _(self) -> None:
        self.near = True


def test_what_a_function_has_made_goes_on_though_it_would_make_another_machine_now(
    tmp_path: Path,
) -> None:
    process = Process(Chooses, file=tmp_path / "kept")
    process.turn(3)
    process.kill()
    process.start()
    process.turn()
    assert process.went_on == [False, True]
    assert [*process.standing] == ["Chooses", "Chooses/Far"]
    far = process.arrangement.machine("Chooses/Far")
    assert isinstance(far, Far)
    assert far.steps == 3
    process.kill()


def test_one_that_is_in_no_module_cannot_go_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    process = Process(Chooses, file=tmp_path / "kept")
    process.turn(3)
    process.kill()
    monkeypatch.delattr(sys.modules[__name__], "Far")
    with pytest.raises(KeepError, match="has Chooses/Far, where Chooses would run Chooses/Near"):
        process.start()
