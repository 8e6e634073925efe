"""The errors of `llfsm.runtime.verification`.

LlfsmError
├── PropertyError              a property does not hold; the text has the shortest
│                              counterexample (also an AssertionError)
└── FsmError
    └── VerificationError      nothing can be decided about the machines
        ├── DomainError        a sensor has no domain, or a wrong one
        ├── UnsupportedError   a machine does what cannot be explored
        ├── RepeatError        a machine's code depends on more than verification sees
        ├── EndlessError       a variable keeps growing
        └── PredicateError     a property raises, returns no bool, or names what does not exist
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from llfsm.errors import LlfsmError
from llfsm.runtime.engine.errors import FsmError

if TYPE_CHECKING:
    from llfsm.runtime.verification.properties import Verdict


class PropertyError(LlfsmError, AssertionError):
    """A property does not hold, or could not be decided; `verdicts` are those of all."""

    def __init__(self, text: str, verdicts: tuple[Verdict, ...]):
        self.verdicts = verdicts
        super().__init__(text)


class VerificationError(FsmError):
    """Machines cannot be explored as asked."""


class DomainError(VerificationError):
    """It is not known, or not possible, what a sensor may read."""


class UnsupportedError(VerificationError):
    """A machine does what cannot be explored; the message names it and what it did."""


class RepeatError(VerificationError):
    """A ringlet did not do the same again: its code reads more than sensors and the state clock."""


class EndlessError(VerificationError):
    """There is no end of new states; the message names the variable that grows."""


class PredicateError(VerificationError):
    """A property's function raised, returned no bool, or named what does not exist."""
