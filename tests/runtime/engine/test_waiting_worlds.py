"""Rounds that are passed over would have changed nothing: random machines do the same without.

Machines post to each other, load, call, suspend, resume and restart each other, wait for messages,
their ages and times, and some have to be polled. All of it is in their texts, so that each world
can be run again with every machine polled.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from definition import BUILT, Defined
from llfsm.errors import LlfsmError
from llfsm.runtime import Actuator, Arrangement, Machine, ManualClock, Sensor, State, define
from llfsm.runtime.testing.waiting import run_until
from llfsm.whiteboard import Slot, Whiteboard
from llfsm.whiteboard.messages.std_msgs import Int32

LEFT, RIGHT = (Slot(name, Int32) for name in ("left", "right"))
NAMES = ("A", "B", "C")
WORLDS = int(os.environ.get("LLFSM_WAITING_WORLDS", "1000"))


def is_high(machine: Any) -> bool:
    """Only read."""
    high: bool = machine.left.data > machine.level
    return high


# Guards, of which the text is read: what is drawn is which of them.
GUARDS: dict[str, Callable[[Any], bool] | None] = {
    "none": None,
    "high": lambda m: m.is_high,
    "low": lambda m: m.left.data <= m.level,
    "fresh": lambda m: m.right is not None,
    "stale": lambda m: m.right is None,
    "both": lambda m: m.right is not None and m.right.data == m.left.data,
    "late": lambda m: m.after_ms(130),
    "late and high": lambda m: m.after(0.05) and m.left.data > 2,
    "counted": lambda m: m.count > 2,
    "stopping": lambda m: m.stopping,
    "asks": lambda m: m.is_suspended("A"),
    "polled": lambda m: m.age_ms("right") is not None and m.age_ms("right") > 35,
    "computed": lambda m: m.after_ms(m.level * 40),
    "held": lambda m: m.timeout(m.time_us),
}
LIMITS = (None, None, 0, 10, 25, 95, 340)
DEEDS = ("left", "right", "suspend", "resume", "restart", "nothing", "nothing", "load", "call")

transitions = st.tuples(st.sampled_from(sorted(GUARDS)), st.sampled_from(LIMITS), st.integers(0, 3))
states = st.tuples(
    st.lists(transitions, max_size=3),
    st.sampled_from(DEEDS),
    st.integers(0, 3),  # of the deed
    st.sampled_from([False, False, False, True]),  # whether it has an Internal
    st.sampled_from([False, False, False, False, True]),  # whether it is final
    st.sampled_from([None, None, None, "B"]),  # what it runs
)
machines = st.tuples(st.lists(states, min_size=1, max_size=4), st.integers(0, 3))
schedules = st.sampled_from([{}, {"period_us": 20_000}, {"timed": True}, {"idle_us": 7_000}])
worlds = st.tuples(
    st.tuples(machines, machines, machines), schedules, st.booleans(), st.integers(1, 120)
)


def make(name: str, drawn: Any, library: dict[str, Any], least_ms: int) -> type[Machine]:
    """Make the machine class of a drawing, of which no transition fires before `least_ms`."""
    rows, level = drawn
    made: list[State] = []
    for number, (_, _, _, _, final, runs) in enumerate(rows):
        # One that runs itself would have no end, and only the last one may be run.
        inner = library.get("C") if runs and name == "A" else None
        made.append(State(f"s{number}", final=final, runs=inner))
    for state, (leads, deed, argument, internal, *_) in zip(made, rows, strict=True):
        for guard, limit, target in [] if state.final else leads:
            after_ms = 0 if guard == "none" and limit is None else limit
            if least_ms:
                after_ms = max(after_ms or 0, least_ms)
            state.to(made[target % len(made)], when=GUARDS[guard], after_ms=after_ms)
        state.on_entry(entering(deed, argument))
        state.on_exit(lambda m: note(m, "exit"))
        state.on_suspend(lambda m: note(m, "suspended"))
        if internal:
            state.internal(counting)
    attributes = {
        "left": Sensor(LEFT, default=Int32()),
        "right": Sensor(RIGHT, max_age_ms=70),
        "to_left": Actuator(LEFT, at_suspend=Int32(-1)),
        "to_right": Actuator(RIGHT, at_end=Int32(-2)),
        "is_high": property(is_high),
    }
    time_us = 20_000 * level
    variables = {"level": (int, level), "count": (int, 0), "time_us": (float, time_us)}
    return define(name, made, variables=variables, attributes=attributes)


def note(machine: Any, what: str) -> None:
    world = machine.world
    now = world.arrangement.environment.machine_now()
    world.log.append((machine.name, machine.state_name, what, world.arrangement.rounds, now))
    world.log.append((machine.left, machine.right, machine.count))


def counting(machine: Any) -> None:
    machine.count += 1


def entering(deed: str, argument: int) -> Callable[[Any], None]:
    def enter(machine: Any) -> None:
        note(machine, "entry")
        machine.count += argument == 1
        other = NAMES[argument % 3]
        names = machine.world.arrangement.states()
        is_there, few = other in names, len(names) < 6
        match deed:
            case "left":
                machine.to_left(Int32(argument))
            case "right":
                machine.to_right(Int32(argument))
            case "load" if few:
                machine.load(other)
            case "call" if few:
                machine.call_machine(other)
            case "suspend" | "resume" | "restart" if is_there:
                getattr(machine, deed)(other)

    return enter


@pytest.fixture(autouse=True, scope="module")
def _quiet() -> Iterator[None]:
    """Log no failures: some guards ask of machines that have left."""
    logging.disable()
    yield
    logging.disable(logging.NOTSET)


@contextmanager
def analysis(given_: Any) -> Iterator[None]:
    before = Arrangement.analysis
    Arrangement.analysis = staticmethod(given_) if given_ else None  # type: ignore[assignment]
    try:
        yield
    finally:
        Arrangement.analysis = before


def run(kind: type[Arrangement], drawn: Any, *, polled: bool, tested: bool = False) -> list[object]:
    """Run a world, as a test runs it if `tested`, and return all that can be seen of it."""
    three, schedule, unloads, rounds = drawn
    log: list[object] = []
    world = SimpleNamespace(log=log)
    library: dict[str, Any] = {}
    for name, each in reversed([*zip(NAMES, three, strict=True)]):
        # `run_until` gives rounds in which a transition fires 10 us: some worlds would have
        # nothing but these.
        library[name] = make(name, each, library, 1 if tested else 0)
        library[name].world = world
    board, clock = Whiteboard.local(), ManualClock()
    world.arrangement = arrangement = kind(
        [library[name] for name in NAMES],
        whiteboard=board,
        clock=clock,
        library=library,
        unload_accepting=unloads,
        on_error="suspend",
        **schedule,
    )
    found = Arrangement.analysis
    with analysis(None if polled else found):
        if tested:
            log += runs_of_a_test(arrangement, rounds)
        else:
            log.append(arrangement.run(max_rounds=rounds))
    ringlets = [(seat.name, seat.progress) for seat in arrangement.roster]
    log += [arrangement.rounds, clock.now_ns(), arrangement.roster.standings(), ringlets]
    log += [(board.get_message(slot), board[slot].count) for slot in (LEFT, RIGHT)]
    if schedule.keys() - {"idle_us"}:
        log += [
            (each.machine, each.ringlets, each.fired, each.state_s)
            for each in arrangement.statistics()
        ]
    return log


def runs_of_a_test(arrangement: Arrangement, rounds: int) -> Iterator[object]:
    """Run until machines are in states, some of which are reached, and some are not."""
    for number, name in enumerate(NAMES):
        place = f"{name}.s{(rounds + number) % 2}"
        try:
            yield run_until(arrangement, place, within_ms=rounds * 2.3)
        except LlfsmError as error:
            yield str(error)


@pytest.mark.filterwarnings("ignore::llfsm.runtime.UnreachableStateWarning")
@settings(max_examples=WORLDS // 10, suppress_health_check=[HealthCheck.too_slow], deadline=None)
@given(drawn=worlds)
def test_a_test_passes_over_the_same(drawn: Any) -> None:
    polled = run(Arrangement, drawn, polled=True, tested=True)
    assert run(Arrangement, drawn, polled=False, tested=True) == polled


@pytest.mark.filterwarnings("ignore::llfsm.runtime.UnreachableStateWarning")
@settings(max_examples=WORLDS, suppress_health_check=[HealthCheck.too_slow], deadline=None)
@given(drawn=worlds)
def test_a_round_that_is_passed_over_would_have_changed_nothing(drawn: Any) -> None:
    assert run(Arrangement, drawn, polled=False) == run(Arrangement, drawn, polled=True)


@pytest.mark.filterwarnings("ignore::llfsm.runtime.UnreachableStateWarning")
@pytest.mark.skipif(not BUILT, reason="there is no twin here: the definition is all there is")
@settings(suppress_health_check=[HealthCheck.too_slow], deadline=None)
@given(drawn=worlds)
def test_the_definition_passes_over_the_same(drawn: Any) -> None:
    assert run(Defined, drawn, polled=False) == run(Arrangement, drawn, polled=False)
