"""The errors of `llfsm.runtime.testing`.

LlfsmError
├── a machine does not behave as the test expects (also an AssertionError)
│   ├── NotReachedError          a condition did not hold in time, or cannot hold any more
│   ├── StatesError              a machine entered other states
│   └── InvariantError           an invariant was violated
└── FsmError                 the test itself is wrong
    ├── ScriptError              a script that cannot be played (also a ValueError)
    ├── NotDeterministicError    the same script does not fail again
    └── HypothesisMissingError   the search needs hypothesis (also an ImportError)
"""

from __future__ import annotations

from llfsm.errors import LlfsmError
from llfsm.runtime.engine.errors import FsmError


class NotReachedError(LlfsmError, AssertionError):
    """A condition did not hold in time; the text has the state of each machine."""


class StatesError(LlfsmError, AssertionError):
    """A machine entered other states than expected; the text has the difference."""


class InvariantError(LlfsmError, AssertionError):
    """An invariant was violated; the text has the ringlet and the state of each machine."""


class ScriptError(FsmError, ValueError):
    """A script cannot be played; the text says which step or machine is wrong."""


class NotDeterministicError(FsmError):
    """A script that failed did not fail again: something depends on more than sensors and clock."""


class HypothesisMissingError(FsmError, ImportError):
    """Hypothesis is not installed."""
