"""Clocks at any time: zones find what small steps of time find, and nothing else."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import product
from math import inf
from random import Random
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clocked_machines import ring
from llfsm.runtime import Machine, State, define
from llfsm.runtime.counterexamples import replay
from llfsm.runtime.verification import Member, Property, _zones, explore, leads_to, never
from llfsm.runtime.verification._breadth_first import Search
from llfsm.runtime.verification._zones import Zone, constrained, delayed
from thoroughness import examples

MS = 1_000_000
Readings = set[tuple[int, ...]]

# Zones, beside sets of readings of three clocks

LIMITS = (1, 2, 1)
SIZE = len(LIMITS) + 1
FAR = 8
"""A reading that is enough for each clock to be beyond its limit, and apart from the others."""
clocks = st.integers(0, len(LIMITS) - 1)
operations = st.one_of(
    st.tuples(st.just("cut"), clocks, st.integers(0, 3), st.sampled_from([0, 1, inf, inf])),
    st.tuples(st.just("restart"), clocks),
    st.tuples(st.just("delay")),
)


def alike(reading: tuple[int, ...]) -> tuple[int, ...]:
    """Readings beyond a clock's limit are alike."""
    return tuple(min(each, limit + 1) for each, limit in zip(reading, LIMITS, strict=True))


def shown(zone: Zone) -> Readings:
    """All readings in a zone, as far as they make a difference."""
    pairs = [(i, j, zone[SIZE * i + j]) for i, j in product(range(SIZE), repeat=2)]
    return {
        alike(reading)
        for reading in product(range(FAR), repeat=len(LIMITS))
        if all((0, *reading)[i] - (0, *reading)[j] <= bound for i, j, bound in pairs)
    }


@settings(max_examples=examples(50), deadline=None)
@given(st.lists(operations, max_size=8))
def test_a_zone_has_the_readings_that_clocks_can_have(done: list[Any]) -> None:
    zone: Zone | None = (0,) * SIZE**2
    readings: Readings = {(0,) * len(LIMITS)}
    for what, *how in [("delay",), *done]:
        assert zone is not None
        match what:
            case "cut":
                clock, low, width = how
                low = min(low, LIMITS[clock] + 1)  # limits are the largest that anybody asks for
                high = low + width if low + width <= LIMITS[clock] else inf
                zone = constrained(zone, SIZE, clock + 1, low, high)
                readings = {each for each in readings if low <= each[clock] <= high}
            case "restart":
                kept = [0 if n == how[0] + 1 else n for n in range(SIZE)]
                zone = tuple(zone[SIZE * i + j] for i in kept for j in kept)
                readings = {
                    tuple(0 if n == how[0] else v for n, v in enumerate(r)) for r in readings
                }
            case "delay":
                zone = delayed(zone, (0, *LIMITS))
                later = (tuple(each + d for each in r) for r in readings for d in range(FAR))
                readings = set(map(alike, later))
        assert (zone is None) is (not readings)
        if zone is None:
            return
        assert shown(zone) == readings


# Machines with clocks, beside an explorer that lets time pass by small steps


def in_small_steps(search: Search, number: int) -> Iterator[int]:
    """Yield all states that are reached if time passes by parts of a millisecond.

    So many clocks, whose limits are whole milliseconds, allow nothing that `number` + 1 parts of
    one do not.
    """
    tables = search.tables
    fields = [tables.fields.get(("elapsed", name)) for name in tables.system.names]
    times = tables.packing.mask(("elapsed", name) for name in tables.system.names)
    first = 0, tables.initial(), (0,) * len(fields)
    waiting, known = [first], {first}
    for turn, state, elapsed in waiting:
        running = {place: limits for place, limits, _ in tables.running(state)}
        parts = range(4 * (number + 1) + 1) if turn == 0 else (0,)
        for passed in parts:
            now = list(elapsed)
            shown = state & ~times
            for place, limits in running.items():
                most = limits[-1] * (number + 1) // MS + 1
                now[place] = min(now[place] + passed, most)
                over = sum(now[place] * MS > limit * (number + 1) for limit in limits)
                field = fields[place]
                assert field is not None
                shown |= over << field.shift
            for step in search.steps(turn, shown):
                if (step.ready ^ shown) & times:
                    continue  # at other times
                after_times = list(now)
                if step.restarted:
                    after_times[step.place] = 0
                after = step.turn, step.state, tuple(after_times)
                yield step.state
                if after not in known:
                    known.add(after)
                    waiting.append(after)


def standing(number: int) -> list[Property]:
    """That these machines never stand in certain states at once."""
    names = "ABCD"[:number]
    return [
        never(lambda v, p=p: tuple(str(v[name].state) for name in names) == p, str(p))
        for p in product(("S0", "S1", "S2"), repeat=number)
    ]


@pytest.mark.filterwarnings("ignore::llfsm.runtime.UnreachableStateWarning")
@pytest.mark.parametrize("number", [2, 3])
@settings(max_examples=examples(3), deadline=None)
@given(seed=st.integers(0, 2**32))
def test_clocks_allow_what_they_do_in_small_steps(number: int, seed: int) -> None:
    machines, sought = ring(number, Random(seed)), standing(number)
    space = explore(machines, any_time=True, properties=sought)
    tables = space.search.tables
    reached = {
        tuple(tables.control(place, state).current for place in range(number))
        for state in in_small_steps(space.search, number)
    } | {("S0",) * number}
    assert {str(v.property) for v in space.verdicts if not v.holds} == set(map(str, reached))
    for verdict in space.verdicts:
        if verdict.witness is not None:
            assert verdict.property.functions[0](replay_to_end(space, verdict.witness))


def replay_to_end(space: Any, witness: Any) -> Any:
    return replay(space, witness)[len(witness.turns)]


@pytest.mark.filterwarnings("ignore::llfsm.runtime.UnreachableStateWarning")
@settings(max_examples=examples(5), deadline=None)
@given(seed=st.integers(0, 2**32))
def test_it_makes_no_difference_how_many_zones_are_kept_first(seed: int) -> None:
    machines, sought = ring(3, Random(seed)), standing(3)
    verdicts = []
    for rooms in ((1, 10, 100, inf), (inf,), (2, inf)):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(_zones, "ROOMS", rooms)
            found = explore(machines, any_time=True, properties=sought).verdicts
            verdicts.append([verdict.holds for verdict in found])
    assert verdicts[0] == verdicts[1] == verdicts[2]


# Many clocks


def one_shot(name: str, ms: int) -> type[Machine]:
    wait, done = State("WAIT"), State("DONE")
    wait.to(done, after_ms=ms)
    done.to(wait, when=lambda self: False)
    return define(name, [wait, done])


def blinker(ms: int) -> type[Machine]:
    on, off = State("ON"), State("OFF")
    on.to(off, after_ms=ms)
    off.to(on, after_ms=ms + 1)
    return define("Blinker", [on, off])


def test_six_clocks_are_decided_though_four_only_blink(monkeypatch: pytest.MonkeyPatch) -> None:
    """By all zones there would be a hundred thousand."""
    monkeypatch.setattr(_zones, "MOST_ZONES", 10_000)
    blinkers = [Member(blinker(5 + 2 * n), name=f"L{n}") for n in range(4)]
    machines = [one_shot("A", 10), one_shot("B", 20), *blinkers]
    order = never(lambda v: v.B.state == "DONE" and v.A.state == "WAIT")
    (verdict,) = explore(machines, any_time=True, properties=[order]).verdicts
    assert verdict.holds is True


def test_it_is_undecided_if_there_are_too_many_zones(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(_zones, "MOST_ZONES", 2)
    order = never(lambda v: v.B.state == "DONE" and v.A.state == "WAIT")
    machines = [one_shot("A", 10), one_shot("B", 20)]
    (verdict,) = explore(machines, any_time=True, properties=[order]).verdicts
    assert (verdict.holds, verdict.witness) == (None, None)


# Responses


def in_state(name: str) -> Callable[[Any], bool]:
    return lambda v: bool(v.A.state == name)


def test_the_next_round_may_come_too_late_for_a_response() -> None:
    prop = leads_to(in_state("DONE"), lambda v: v.A.accepted, within_ms=50)
    done, wait = State("DONE"), State("WAIT")
    wait.to(done, after_ms=10)
    machine = define("A", [wait, done])
    (verdict,) = explore(machine, any_time=True, properties=[prop]).verdicts
    assert verdict.holds is False
    assert verdict.witness is not None
    times = {turn.round: turn.time_ms for turn in verdict.witness.turns}
    assert list(times.values()) == [0, 10.000001, 60.000002]


def test_what_comes_in_the_same_round_is_in_time() -> None:
    follow, told = State("FOLLOW"), State("TOLD")
    follow.to(told, when=lambda self: self.state_name_of("A") == "DONE")
    told.to(follow, when=lambda self: False)
    machines = [one_shot("A", 10), define("B", [follow, told])]
    prop = leads_to(in_state("DONE"), lambda v: v.B.state == "TOLD", within_ms=0)
    assert explore(machines, any_time=True, properties=[prop]).verdicts[0].holds is True
    (verdict,) = explore(machines[::-1], any_time=True, properties=[prop]).verdicts
    assert verdict.holds is False


def test_a_response_is_due_only_if_clocks_allow_its_trigger() -> None:
    late = leads_to(
        lambda v: v.B.state == "DONE" and v.A.state == "WAIT", lambda v: False, within_ms=5
    )
    machines = [one_shot("A", 10), one_shot("B", 20)]
    (verdict,) = explore(machines, any_time=True, properties=[late]).verdicts
    assert verdict.holds is True
