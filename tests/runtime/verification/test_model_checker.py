"""Verdicts of liveness are those of pyModelChecking, where it is installed (it is GPL)."""

from __future__ import annotations

import warnings
from random import Random
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clocked_machines import ring
from llfsm.runtime.verification import (
    Property,
    always_possible,
    eventually_always,
    explore,
    leads_to,
)
from thoroughness import examples

with warnings.catch_warnings():  # of a parser that it imports
    warnings.simplefilter("ignore", DeprecationWarning)
    CTL = pytest.importorskip("pyModelChecking.CTL")
    CTLS = pytest.importorskip("pyModelChecking.CTLS")
    Kripke = pytest.importorskip("pyModelChecking").Kripke

MOST_STATES = 16
"""With more, a formula that is not of CTL takes long."""


def there(v: Any) -> bool:
    return bool(v.A.state == "S1")


def other(v: Any) -> bool:
    return bool(v.B.state == "S1")


MEANT: list[tuple[Property, Any, Any]] = [
    (always_possible(there), CTL, CTL.AG(CTL.EF("there"))),
    (leads_to(there, other), CTL, CTL.AG(CTL.Imply("there", CTL.AF("other")))),
    (eventually_always(there), CTLS, CTLS.A(CTLS.F(CTLS.G("there")))),
]


@pytest.mark.filterwarnings("ignore::llfsm.runtime.UnreachableStateWarning")
@settings(max_examples=examples(10), deadline=None)
@given(seed=st.integers(0, 2**32))
def test_liveness_and_possibility_are_what_formulas_say(seed: int) -> None:
    """These machines never end."""
    space = explore(ring(2, Random(seed)), period_ms=1, properties=[prop for prop, *_ in MEANT])
    search, tables = space.search, space.search.tables
    nodes = [(turn, s) for level in search.levels for turn, each in level.items() for s in each]
    numbers = {node: number for number, node in enumerate(nodes)}
    edges = [(numbers[node], numbers[to]) for node in nodes for to in search.after(*node)]
    labels = {
        number: {
            name
            for place, name in enumerate(("there", "other"))
            if tables.control(place, state).current == "S1"
        }
        for number, (_, state) in enumerate(nodes)
    }
    model = Kripke(S=[*numbers.values()], R=edges, L=labels)
    for (_, checker, formula), verdict in zip(MEANT, space.verdicts, strict=True):
        if checker is CTL or space.states <= MOST_STATES:
            assert verdict.holds is (0 in checker.modelcheck(model, formula))
