"""The errors of `llfsm.runtime.testing`.

AssertionError               a machine does not do what the test says
├── NotReachedError          a condition did not come true in time, or cannot any more
├── StatesError              a machine went through other states
└── InvariantError           an invariant was violated

FsmError                     the test itself is wrong
├── ScriptError              a script that cannot be played (also a ValueError)
├── NotDeterministicError    the same script does not lead to the same failure
└── HypothesisMissingError   the search needs hypothesis (also an ImportError)
"""

from __future__ import annotations

from ..engine.errors import FsmError

__all__ = [
    "HypothesisMissingError",
    "InvariantError",
    "NotDeterministicError",
    "NotReachedError",
    "ScriptError",
    "StatesError",
]


class NotReachedError(AssertionError):
    """Say what was waited for, for how long, and where each machine stood."""


class StatesError(AssertionError):
    """Show where the states of a machine differ from those expected."""


class InvariantError(AssertionError):
    """Say which invariant was violated, after whose ringlet, and where each machine stood."""


class ScriptError(FsmError, ValueError):
    """Say what in a script cannot be played."""


class NotDeterministicError(FsmError):
    """Say that a machine depends on more than its sensors and the clock."""


class HypothesisMissingError(FsmError, ImportError):
    """Say that hypothesis is not installed, and how to install it."""
