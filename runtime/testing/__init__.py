"""What tests of machines need: wait under a manual clock, feed sensors, compare, search for bugs.

Read in this order: `waiting` (run until a condition holds), `sensors` (messages at given times),
`traces` (which states a machine went through), then `replay` (a script and what it breaks),
`source` (a script as Python text) and `invariants` (look for such a script at random).
"""

from .errors import (
    HypothesisMissingError,
    InvariantError,
    NotDeterministicError,
    NotReachedError,
    ScriptError,
    StatesError,
)
from .invariants import check_invariant
from .replay import Invariant, Step, play
from .sensors import SensorScript
from .traces import assert_states, states_of
from .waiting import Condition, run_until

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
