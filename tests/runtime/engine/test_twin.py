"""The twins in C do what the definitions in Python do, and keep no references."""

from __future__ import annotations

import gc
import logging
import re
import sys
import weakref
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from definition import BUILT, Defined
from llfsm.runtime import Actuator, Arrangement, ExecutionError, Machine, ManualClock, Sensor, State
from llfsm.runtime.engine import events, ringlet
from llfsm.runtime.engine.machine import define
from llfsm.whiteboard import Slot, Whiteboard
from llfsm.whiteboard.messages.std_msgs import Int32

pytestmark = pytest.mark.skipif(not BUILT, reason="the twins in C are not built, or hidden")

LEFT, RIGHT, OUT = (Slot(name, Int32) for name in ("left", "right", "out"))
NAMES = ["A", "B", "C"]
SECTIONS = ["on_entry", "on_exit", "internal", "on_suspend", "on_resume"]

# What code may do, and what a guard may return, is data: it is played on both sides.
deeds = st.one_of(
    st.tuples(st.just("post"), st.integers(0, 9)),
    st.tuples(st.just("post left"), st.none()),
    st.tuples(st.just("change left"), st.none()),
    st.tuples(st.sampled_from(["suspend", "resume", "restart", "abandon", "unload"]),
              st.sampled_from(NAMES)),
    st.tuples(st.sampled_from(["load", "call", "leave", "suspend all", "round"]), st.none()),
    st.tuples(st.just("wait"), st.integers(0, 20)),
    st.tuples(st.just("raise"), st.sampled_from([RuntimeError, KeyboardInterrupt, SystemExit])),
)  # fmt: skip
guards = st.one_of(
    st.none(),
    st.booleans(),
    st.tuples(st.sampled_from(["left", "right"]), st.integers(0, 3)),
    st.sampled_from([1, "yes", "raise", "yield"]),
)
sections = st.dictionaries(st.sampled_from(SECTIONS), st.lists(deeds, min_size=1, max_size=2))
transitions = st.lists(
    st.tuples(
        st.integers(0, 3),
        guards,
        st.one_of(st.none(), st.sampled_from([0, 5, 7.5])),
        st.sampled_from(["", "", "done", "failed"]),
    ),
    max_size=3,
)
runs = st.tuples(st.sets(st.integers(0, 2), max_size=2), st.booleans())  # with a history
nothing = st.just((set[int](), False))
resuming = st.sampled_from(
    [{}, {}, {"resume": "in_place"}, {"resume": "in_place", "clock": "stops"}]
)
states = st.tuples(sections, transitions, resuming, st.one_of(nothing, nothing, runs))
machines = st.lists(states, min_size=1, max_size=4)
worlds = st.tuples(
    st.lists(machines, min_size=1, max_size=3),
    st.sampled_from(["stop", "suspend"]),
    st.booleans(),  # unload_accepting
    st.booleans(),  # the first one begins suspended
    st.booleans(),  # an observer comes and goes during rounds
    st.sampled_from([{}, {"timed": True}, {"period_us": 3_000}]),
)
happenings = st.lists(
    st.tuples(
        st.sampled_from(["left", "right", "suspend", "resume", "restart", "nothing", "rest"]),
        st.integers(0, 3),
    ),
    min_size=1,
    max_size=8,
)


def text(value: object) -> str:
    """Return a value's text without the addresses of objects."""
    return re.sub("at 0x[0-9a-f]+", "", str(value))


class World:
    """One arrangement of machines that were drawn, and a list of all that it did."""

    def __init__(self, kind: type[Arrangement], drawn: Any):
        specs, on_error, unload_accepting, first_suspended, self.watched, self.schedule = drawn
        self.clock, self.board = ManualClock(), Whiteboard.local()
        self.did: list[object] = []
        self.classes: dict[str, type[Machine]] = {}
        for name, spec in zip(NAMES, specs, strict=False):  # each may run those before it
            self.classes[name] = self.machine(name, spec)
        classes = self.classes
        first, *others = classes.values()
        self.arrangement = kind(
            others if first_suspended else classes.values(),
            start_suspended=[first] if first_suspended else [],
            whiteboard=self.board,
            clock=self.clock,
            on_error=on_error,
            unload_accepting=unload_accepting,
            library=classes,
            **self.schedule,
        )

    def machine(self, name: str, spec: Any) -> type[Machine]:
        states = [
            State(f"S{number}", history=history, runs=self.what_runs(places), **resumes)
            for number, (*_, resumes, (places, history)) in enumerate(spec)
        ]
        for state, (codes, leads, *_) in zip(states, spec, strict=True):
            for section, what in codes.items():
                getattr(state, section)(self.code(state.name, section, what))
            for target, guard, after_ms, end in leads:
                if any(each.unconditional for each in state.transitions):
                    break
                way = state.to(
                    states[target % len(states)],
                    when=None if guard is None else self.guard(guard),
                    after_ms=after_ms,
                )
                if state.runs and end:
                    way.wait_for_end(done=end == "done", failed=end == "failed")
        ports = {
            "left": Sensor(LEFT),
            "right": Sensor(RIGHT, default=Int32(data=2)),
            "out": Actuator(OUT, at_suspend=Int32(data=-1), at_end=Int32(data=-2)),
        }
        return define(name, states, attributes=ports)

    def what_runs(self, places: set[int]) -> Any:
        """Make what a state runs: the machines at these places, if they are there."""
        found = [name for place, name in enumerate(self.classes) if place in places]
        return [self.classes[name] if name == "A" else name for name in found] or None

    def code(self, state: str, section: str, what: list[tuple[str, Any]]) -> Callable[[Any], None]:
        def run(machine: Any) -> None:
            self.did.append((machine.name, state, section, machine.state_name, self.clock.now_ns()))
            for verb, argument in what:
                self.do(machine, verb, argument)

        return run

    def do(self, machine: Any, verb: str, argument: Any) -> None:
        match verb:
            case "post":
                machine.out(Int32(data=argument))
            case "post left":
                machine.out(machine.left or Int32(data=-3))
            case "change left":
                machine.left = None
            case "wait":
                self.clock.advance(ms=argument)
                self.arrangement.detach(self.observe)
                if self.watched and argument % 4 == 0:
                    self.arrangement.attach(self.observe)
            case "load":
                if self.arrangement.control.number_of_machines < 6:
                    machine.load("A")
            case "call":
                if self.arrangement.control.number_of_machines < 6:
                    machine.call_machine("A")
            case "suspend all":
                machine.suspend_all()
            case "round":
                if len(self.did) < 40 and "period_us" not in self.schedule:
                    self.did.append(self.arrangement.round())
            case "leave":
                machine.unload(machine.name)
            case "abandon":
                if self.arrangement.rounds < 4 and len(self.did) < 60:
                    machine.abandon(argument)
            case "raise":
                raise argument("on purpose")
            case _:
                getattr(machine, verb)(argument)

    def observe(self, event: events.Event) -> None:
        self.did.append(text(event))

    def guard(self, drawn: Any) -> Callable[[Any], Any]:
        def hold(machine: Any) -> Any:
            match drawn:
                case (sensor, value):
                    message = getattr(machine, sensor)
                    return message is not None and message.data == value
                case "raise":
                    raise ValueError("on purpose, too")
                case "yield":
                    return iter(())
            return drawn

        return hold

    def happen(self, what: str, number: int) -> None:
        """Let something happen, and then have a round, or several while nothing changes."""
        sleeps = iter([True] * number if what == "rest" else [])

        def sleep() -> bool:
            self.did.append((self.arrangement.rounds, self.clock.now_ns()))
            self.clock.advance(ms=5)
            return next(sleeps, False)

        if what in ("left", "right"):
            self.board.add_message(LEFT if what == "left" else RIGHT, Int32(data=number))
        elif what not in ("nothing", "rest") and self.arrangement.machines:
            names = [each.name for each in self.arrangement.machines]
            getattr(self.arrangement, what)(names[number % len(names)])
        try:
            self.did.append(self.arrangement.kernel.rest(sleep))
        except BaseException as error:
            self.did.append((type(error), text(error), text(repr(error.__cause__))))
        self.clock.advance(ms=5)
        self.did.append(self.arrangement.roster.standings())
        for machine in self.arrangement.machines:
            self.did.append(
                (machine.left, machine.right, self.arrangement.roster.find(machine.name).arrival())
            )
            self.did.append(text(self.arrangement.roster.find(machine.name).failure))
        self.did.append((self.board.get_message(OUT), self.board[OUT].count))
        if self.schedule:
            self.did.append(self.arrangement.statistics())


@pytest.fixture(scope="module")
def _quiet() -> Iterator[None]:
    """Log no failures: there are thousands, on purpose."""
    logging.disable()
    yield
    logging.disable(logging.NOTSET)


LEAVES_AFTER_5_MS: Any = ({}, [(1, None, 5, "")], {}, (set(), False))
STAYS: Any = ({}, [], {}, (set(), False))
AT_THE_LIMIT = [[LEAVES_AFTER_5_MS, STAYS]], "stop", False, False, False, {}
"""A turn is given at the very time after which a transition fires."""


@given(drawn=worlds, events_=happenings)
@example(drawn=AT_THE_LIMIT, events_=[("nothing", 0)] * 4)
@pytest.mark.filterwarnings("ignore::llfsm.runtime.UnreachableStateWarning")
@pytest.mark.usefixtures("_quiet")
def test_random_machines_do_the_same_on_both(drawn: Any, events_: list[tuple[str, int]]) -> None:
    twin_, defined = World(Arrangement, drawn), World(Defined, drawn)
    for what, number in events_:
        twin_.happen(what, number)
        defined.happen(what, number)
        assert twin_.did == defined.did


class Busy(Machine):
    """Use all that a ringlet can do, and fail now and then."""

    left = Sensor(LEFT)
    right = Sensor(RIGHT, default=Int32(data=2))
    turns: int = 0

    one = State()
    two = State()
    asleep = State(suspend=True)

    @one.on_entry
    def _(self) -> None:
        self.turns += 1

    @one.to(two)
    def always(self) -> bool:
        return self.turns >= 0

    @two.internal
    def _(self) -> None:
        self.turns += 1
        if self.turns % 1000 == 0:
            raise RuntimeError("on purpose")

    two.to(one, after_ms=1)

    @two.on_suspend
    def _(self) -> None:
        self.turns += 1

    @asleep.on_resume
    def _(self) -> None:
        self.turns += 1


@pytest.mark.usefixtures("_quiet")
@pytest.mark.parametrize("clock", [None, ManualClock()], ids=["monotonic", "manual"])
def test_a_million_turns_keep_no_references(clock: ManualClock | None) -> None:
    board = Whiteboard.local()
    board.add_message(LEFT, Int32(data=1))
    machines = [Busy() for _ in range(10)]
    arrangement = Arrangement(
        machines, whiteboard=board, clock=clock, on_error="suspend", timed=clock is None
    )
    state, seat = Busy.table.states[0], arrangement.roster.find(machines[0].name)
    held = [machines[0], board.get_message(LEFT), Busy.right.default, state.sections["OnEntry"],
            state.transitions[0].guard, seat, *seat.states.values()]  # fmt: skip
    if sys.version_info < (3, 12):  # later ones do not count references to these
        held += [None, True, False]

    def run(rounds: int) -> tuple[list[int], int]:
        for number in range(rounds):
            arrangement.round()
            if clock is not None and number % 3 == 0:
                clock.advance(ms=1)
            if number % 100 == 0:
                for machine in machines:
                    arrangement.suspend(machine.name)
            if number % 100 == 2:
                for machine in machines:
                    arrangement.resume(machine.name)
        gc.collect()
        return [sys.getrefcount(each) for each in held], sys.getallocatedblocks()

    run(2000)
    references, blocks = run(1000)
    after = run(100_000)
    assert machines[0].turns > 10_000
    assert all(abs(now - then) < 100 for then, now in zip(references, after[0], strict=True))
    assert abs(after[1] - blocks) < 10_000  # one in a hundred turns; errors that stand have some


@pytest.mark.parametrize("kind", [Arrangement, Defined])
def test_an_arrangement_that_nobody_holds_is_freed(kind: type[Arrangement]) -> None:
    machine = Busy()
    arrangement = kind([machine], whiteboard=Whiteboard.local(), on_error="suspend")
    arrangement.round()
    left = [weakref.ref(arrangement), weakref.ref(machine)]
    del arrangement, machine
    gc.collect()
    assert [each() for each in left] == [None, None]


@pytest.mark.parametrize("kind", [Arrangement, Defined])
def test_a_state_without_a_clock_has_lasted_for_ever(kind: type[Arrangement]) -> None:
    """In a round nested in OnSuspend, before the suspend state's clock starts."""

    class Nests(Machine):
        a = State()
        away = State(suspend=True)
        away.to(a, after_ms=0)

        @a.on_suspend
        def _(self) -> None:
            fired.append(arrangement.round())

    fired: list[bool] = []
    arrangement = kind(start_suspended=[Nests], clock=ManualClock())
    arrangement.round()
    assert fired == [True]


def loaded() -> tuple[Arrangement, Any]:
    arrangement = Arrangement([Busy], whiteboard=Whiteboard.local(), timed=True)
    return arrangement, arrangement.roster.find("Busy")


@pytest.mark.parametrize("field", ["machine", "request", "sensors", "current", "previous", "now"])
def test_a_field_that_was_deleted_is_an_error(field: str) -> None:
    arrangement, seat = loaded()
    delattr(seat, field)
    with pytest.raises((AttributeError, ExecutionError), match=f"{field}|is missing"):
        arrangement.round()


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("current", "one"),
        ("sensors", None),
        ("sensors", (1,)),
        ("sensors", ((),)),
        ("now", 5),
        ("meter", 5),
        ("timed", 5),
    ],
)
def test_a_field_that_is_of_another_type_is_an_error(field: str, value: object) -> None:
    arrangement, seat = loaded()
    setattr(seat, field, value)
    with pytest.raises((TypeError, SystemError, ExecutionError)):
        arrangement.round()


def test_only_seats_have_ringlets() -> None:
    wrong: Any = object()
    with pytest.raises(TypeError, match="a ringlet is one of a seat, not of <object"):
        ringlet.ringlet(wrong)
    with pytest.raises(TypeError, match="not iterable"):
        Arrangement().kernel.give_turns(wrong)
    assert ringlet.running(wrong) is None


@pytest.mark.parametrize("of", ["costs", "jitters"])
def test_only_meters_time_turns_and_only_histograms_count(of: str) -> None:
    arrangement, seat = loaded()
    wrong: Any = object()
    arrangement.round()
    setattr(seat.meter, of, wrong)
    stopwatch: Any = arrangement.kernel.stopwatch
    stopwatch.deadline_ns = 0
    stopwatch.take(seat, False) if of == "jitters" else None
    with pytest.raises(TypeError, match="a Histogram is of another type"):
        stopwatch.take(seat, False)
    with pytest.raises(TypeError, match="a Histogram is of another type"):
        stopwatch.begin_due(0, 0, wrong)
    with pytest.raises(TypeError, match="a seat is of another type"):
        stopwatch.take(wrong, False)
    arrangement.kernel.stopwatch = wrong
    with pytest.raises(TypeError, match="a stopwatch is of another type"):
        arrangement.round()
