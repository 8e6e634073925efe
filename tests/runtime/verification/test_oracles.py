"""What is explored agrees with what others find: a naive explorer, SPIN, and swiftfsm."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from random import Random
from typing import Any

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from agreement import Situation, assert_agreement, situations
from llfsm.machines.properties.mine import MINE
from llfsm.machines.properties.oven import OVEN
from llfsm.runtime import Actuator, Machine, Sensor, State, define
from llfsm.runtime.verification import explore, never
from llfsm.whiteboard import Slot
from llfsm.whiteboard.messages.std_msgs import Bool
from naive_explorer import May, naively_explored
from spin import count
from thoroughness import examples

_LEAVER: Any = [({}, [(1, ("left", 1), None)]), ({}, [])]
_ASKS: Any = [({"on_exit": [("unload", "C")]}, [(0, ("right", 1), 5)])]
LEFT_BEFORE = Situation([_LEAVER, _ASKS, _LEAVER], True, 10, May(stop=True, suspend={"A"}))
"""Who has left when B asks for C is in the text of an error."""


@pytest.mark.filterwarnings("ignore::llfsm.runtime.UnreachableStateWarning")
@settings(max_examples=examples(8), suppress_health_check=list(HealthCheck), deadline=None)
@given(situations)
@example(LEFT_BEFORE)
def test_random_machines_have_the_same_states_and_verdicts(situation: Situation) -> None:
    """`make soak` compares more of them."""
    assert_agreement(situation, most=250)


@pytest.mark.parametrize(
    ("machines", "model", "period_ms"),
    [(OVEN, "microwave.pml", 60_000), (MINE, "mine_pump.pml", 1000)],
    ids=["microwave", "mine pump"],
)
def test_spin_counts_the_same(machines: Any, model: str, period_ms: int, tmp_path: Path) -> None:
    """The models are written by hand; `make soak` compares other periods."""
    space = explore(machines, period_ms=period_ms)
    counted = count(Path(__file__).with_name(model), tmp_path, PERIOD=period_ms)
    assert (space.states, space.transitions) == counted
    domains = {
        sensor.slot: list(sensor.domain)
        for machine in machines
        for sensor in machine.table.sensors.values()
        if sensor.domain is not None
    }
    naive = naively_explored(machines, period_ms=period_ms, domains=domains)
    assert (naive.states, naive.transitions) == counted


COUNTS = Path(__file__).parents[3] / "docs" / "gallery" / "index.md"
ROW = re.compile(
    r"^\| ([\d.]+) (m?s) \| ([\d,]+) \| ([\d,]+) \| ([\d,]+) \| ([\d,]+) \|$", re.MULTILINE
)


def test_the_documents_give_the_counts() -> None:
    """Of the periods that are soon explored; `make soak` prints all."""
    rows = ROW.findall(COUNTS.read_text())
    assert len(rows) == 5
    for time, unit, *figures in rows[:3]:
        period_ms = float(time) * (1000 if unit == "s" else 1)
        spaces = [explore(machines, period_ms=period_ms) for machines in (OVEN, MINE)]
        found = [number for space in spaces for number in (space.states, space.transitions)]
        assert found == [int(each.replace(",", "")) for each in figures]


TO_A, TO_B = Slot("to_a", Bool), Slot("to_b", Bool)
GUARDS: list[Callable[[Any, int], bool]] = [
    lambda self, ms: self.after_ms(ms),
    lambda self, ms: self.there.data and self.after_ms(ms),
    lambda self, ms: self.there.data and not self.after_ms(ms),
    lambda self, ms: not self.there.data and not self.after_ms(ms),
    lambda self, _: self.there.data,
]


def with_a_clock(name: str, choose: Random, reads: Slot[Bool], posts: Slot[Bool]) -> type[Machine]:
    """Return a machine that tells the other one something, and looks at it and at its clock."""
    states = [State(f"S{number}") for number in range(3)]
    for state in states:
        printed = Bool(data=choose.random() < 0.5)
        state.on_entry(lambda self, printed=printed: self.tell(printed))
        for _ in range(choose.randint(1, 2)):
            guard, ms = choose.choice(GUARDS), choose.randint(1, 3)
            state.to(choose.choice(states), when=lambda self, g=guard, ms=ms: g(self, ms))
    ports = {"there": Sensor(reads, default=Bool()), "tell": Actuator(posts)}
    return define(name, states, attributes=ports)


@pytest.mark.filterwarnings("ignore::llfsm.runtime.UnreachableStateWarning")
@settings(max_examples=examples(4), deadline=None)
@given(st.integers(0, 2**32))
@example(2)
@example(69)
def test_at_any_time_two_clocks_allow_what_they_do_in_small_steps(seed: int) -> None:
    """Limits are whole milliseconds: two clocks allow nothing that thirds of one do not.

    In the examples that are given, some ways need clocks that do not run alike.
    """
    choose = Random(seed)
    machines = [with_a_clock("A", choose, TO_A, TO_B), with_a_clock("B", choose, TO_B, TO_A)]
    naive = naively_explored(machines, period_ms=[third / 3 for third in range(11)], domains={})
    reached = {(view["A.state"], view["B.state"]) for view in naive.views.values()}
    names = [f"S{number}" for number in range(3)]
    pairs = [(one, other) for one in names for other in names]
    sought = [never(lambda v, p=p: (v.A.state, v.B.state) == p, str(p)) for p in pairs]
    verdicts = explore(machines, any_time=True, properties=sought).verdicts
    assert [verdict.holds for verdict in verdicts] == [pair not in reached for pair in pairs]
