"""Verdicts of liveness are those of pyModelChecking, where it is installed (it is GPL)."""

from __future__ import annotations

import warnings
from random import Random

import pytest
from hypothesis import assume, given, settings
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

P, Q, R = (
    lambda v: v.A.state == "S1",
    lambda v: v.B.state == "S1",
    lambda v: v.A.state == "S2",
)
MEANT: list[tuple[Property, object]] = [
    (eventually_always(P), CTLS.A(CTLS.F(CTLS.G("p")))),
    (leads_to(P, Q), CTLS.A(CTLS.G(CTLS.Imply("p", CTLS.F("q"))))),
    (always_possible(P), CTL.AG(CTL.EF("p"))),
    (always_possible(R), CTL.AG(CTL.EF("r"))),
]


@pytest.mark.filterwarnings("ignore::llfsm.runtime.UnreachableStateWarning")
@settings(max_examples=examples(3), deadline=None)
@given(seed=st.integers(0, 2**32))
def test_liveness_and_possibility_are_what_formulas_say(seed: int) -> None:
    """These machines never end; formulas of CTL* take long with more states."""
    space = explore(ring(2, Random(seed)), period_ms=1, properties=[prop for prop, _ in MEANT])
    assume(space.states <= 20)
    search, tables = space.search, space.search.tables
    nodes = [(turn, s) for level in search.levels for turn, each in level.items() for s in each]
    edges = [(node, after) for node in nodes for after in search.after(*node)]
    labels = {}
    for turn, state in nodes:
        first, second = (tables.control(place, state).current for place in range(2))
        holds = {"p": first == "S1", "q": second == "S1", "r": first == "S2"}
        labels[turn, state] = {name for name, held in holds.items() if held}
    model = Kripke(S=nodes, R=edges, L=labels)
    for (_, formula), verdict in zip(MEANT, space.verdicts, strict=True):
        checker = CTL if isinstance(formula, CTL.AG) else CTLS
        assert verdict.holds is (nodes[0] in checker.modelcheck(model, formula))
