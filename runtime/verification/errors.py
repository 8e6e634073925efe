"""The errors of `llfsm.runtime.verification`.

LlfsmError
├── PropertyError (in `properties`)   a property does not hold; the text has the shortest
│                                     counterexample (also an AssertionError)
└── FsmError
    └── VerificationError      nothing can be decided: a variable keeps growing, or code depends on
        │                      more than verification sees
        ├── DomainError        a sensor has no domain, or a wrong one
        ├── UnsupportedError   a machine does what cannot be explored
        └── PredicateError     a property raises, returns no bool, or names what does not exist
"""

from __future__ import annotations

from llfsm.runtime.engine.errors import FsmError


class VerificationError(FsmError):
    """Machines cannot be explored as asked; the message names the machine, and what to change."""


class DomainError(VerificationError):
    """A sensor has no domain, or one that its slot cannot hold or that has too many messages."""


class UnsupportedError(VerificationError):
    """A machine does what cannot be explored; the message names it and what it did."""


class PredicateError(VerificationError):
    """A property's function raised, returned no bool, or named what does not exist."""
