"""Tests of machines: wait under a manual clock, script sensors, compare states, search for bugs.

Read in this order: `waiting` (run until a condition holds, with messages at given times), `states`
(the states that a machine entered), `play` (a script and the invariant that it violates) and
`search` (random scripts, the shortest that fails as Python text).
"""

from llfsm.runtime.testing.errors import (
    HypothesisMissingError,
    InvariantError,
    NotDeterministicError,
    NotReachedError,
    ScriptError,
    StatesError,
)
from llfsm.runtime.testing.play import Invariant, play
from llfsm.runtime.testing.scripted import Step
from llfsm.runtime.testing.search import check_invariant
from llfsm.runtime.testing.waiting import (
    Condition,
    SensorScript,
    assert_states,
    run_until,
    states_of,
)

__all__ = [
    "Condition",
    "HypothesisMissingError",
    "Invariant",
    "InvariantError",
    "NotDeterministicError",
    "NotReachedError",
    "ScriptError",
    "SensorScript",
    "StatesError",
    "Step",
    "assert_states",
    "check_invariant",
    "play",
    "run_until",
    "states_of",
]
