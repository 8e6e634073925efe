"""What violates a property does so again as a script, observed or not, and its journal reruns."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import nullcontext, suppress
from typing import Any

import pytest
from hypothesis import HealthCheck, assume, given, reject, settings
from hypothesis import strategies as st

from agreement import DOMAINS, Situation, situations
from llfsm.bridges.recording.rerun import Rerun
from llfsm.runtime import ExecutionError
from llfsm.runtime.counterexamples import (
    between_of,
    holds,
    replay,
    rows_of,
    script_of,
    table_of,
    view_of,
)
from llfsm.runtime.testing import InvariantError, play
from llfsm.runtime.testing.play import ScriptRun, journal_of
from llfsm.runtime.verification import (
    NO_FAILURE,
    Space,
    UnsupportedError,
    Verdict,
    View,
    always_possible,
    eventually_always,
    explore,
    leads_to,
    never,
    step,
)
from llfsm.runtime.verification.properties import LIVENESS
from random_machines import LEFT, RIGHT, SHARED, built
from thoroughness import examples

PROPERTIES = [
    NO_FAILURE,
    never(lambda v: v.A.n == 1),
    never(lambda v: str(v.A.state) == "S1"),
    never(lambda v: v[SHARED].data == 1),
    step(lambda before, after: before.A.n == after.A.n),
    leads_to(lambda v: v.A.n == 0, lambda v: v[SHARED].data == 2, within_ms=20),
    leads_to(lambda v: v.A.n == 0, lambda v: v[SHARED].data == 2),
    leads_to(lambda v: v.A.n == 0, [lambda v: v.A.n == 1, lambda v: v[SHARED].data == 2]),
    eventually_always(lambda v: v.A.n == 0),
    always_possible(lambda v: v.A.n == 1),
]
AT_ANY_TIME = [each for each in PROPERTIES if each.kind not in LIVENESS or each.within_ms]


def dumped(view: View, names: Iterable[str]) -> list[str]:
    """Return all that a view shows of a state, of the machines of these names."""
    machines = [view[name] for name in names]
    shown = [[m.state, m.accepted, m.loaded, m.n, m.kept, m.pushed, m.left] for m in machines]
    return [*map(repr, shown), repr([view[slot] for slot in (LEFT, RIGHT, SHARED)])]


def replays(space: Space, verdict: Verdict) -> None:
    """Check that a counterexample is one, in each way in which it can be played."""
    assert verdict.witness is not None
    script = script_of(verdict.witness, space)
    between_ms = between_of(verdict.witness)
    how: Any = {"unload_accepting": space.unload_accepting, "on_error": space.on_error}
    with pytest.raises((InvariantError, ExecutionError)):
        play(
            space.members,
            script,
            invariant=holds(verdict.property, between_ms=between_ms),
            to_end=bool(space.suspend),
            **how,
        )
    played, journal = journal_of(space.members, script, **how)
    alone = ScriptRun(space.members, **how)
    for _ in alone.play(script):
        pass
    assert alone.arrangement.roster.standings() == played.arrangement.roster.standings()
    names = [*alone.scripted.machines]
    end = dumped(view_of(alone.scripted), names)
    assert end == dumped(view_of(played.scripted), names)
    with suppress(ExecutionError) if alone.error else nullcontext():
        assert dumped(replay(space, verdict.witness)[-1], names) == end
    again = Rerun(journal)
    arrangement = again.arrange(**how)
    for member in space.members:
        member.load(arrangement)
    assert again.compare() is None
    rows = rows_of(space.members, script, **how)
    turns = (*verdict.witness.turns, *verdict.witness.rest)
    assert [(row.round, row.machine) for row in rows] == [(t.round, t.machine) for t in turns]
    assert table_of(rows, len(rows) - 1).count("\n") >= bool(rows)


@pytest.mark.filterwarnings("ignore::llfsm.runtime.UnreachableStateWarning")
@settings(max_examples=examples(8), suppress_health_check=list(HealthCheck), deadline=None)
@given(situations, st.booleans())
def test_every_counterexample_replays_in_every_way(situation: Situation, any_time: bool) -> None:
    try:
        space = explore(
            built(situation.machines),
            period_ms=None if any_time else situation.period_ms,
            any_time=any_time,
            sensors=DOMAINS,
            properties=AT_ANY_TIME if any_time else PROPERTIES,
            stop=situation.may.stop,
            suspend=situation.may.suspend,
            choices="rounds" if situation.may.by_rounds else "turns",
            unload_accepting=situation.unload_accepting,
            on_error=situation.on_error,
            max_states=1_000,
        )
    except UnsupportedError:
        reject()
    violated = [verdict for verdict in space.verdicts if verdict.holds is False]
    assume(violated)
    for verdict in violated:
        if verdict.witness is not None and verdict.witness.turns:
            replays(space, verdict)
