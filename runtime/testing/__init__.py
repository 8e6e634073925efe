"""Tests of machines: wait under a manual clock, script sensors, compare states, search for bugs.

`waiting` runs an arrangement until a condition holds, with messages at given times, and compares
the states that a machine entered. `scripted` has scripts and the environment that posts them,
`play` runs one and checks an invariant, and `search` looks for the shortest that violates it.
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
