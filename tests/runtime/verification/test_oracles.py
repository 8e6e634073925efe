"""What is explored agrees with what others find: a naive explorer, SPIN, and swiftfsm."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, example, given, settings

from agreement import Situation, assert_agreement, situations
from llfsm.machines.properties.mine import MINE
from llfsm.machines.properties.oven import OVEN
from llfsm.runtime.verification import explore
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
