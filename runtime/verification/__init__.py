"""Verify machines: explore all that they can do, and decide what must never or always hold.

    from llfsm.runtime.verification import every, never, verify

    verify(
        [Timer, Cooker],
        never(lambda v: v.Cooker.door.open and v[MOTOR].on, "no radiation"),
        period_ms=1000,
        sensors={DOOR: every(Door)},
    )

Read in this order: `domains`, `values` (keys of values), `explored` (what a ringlet may ask),
`ringlets` (one ringlet from any state), `passing` (of time), `system` (all ringlets, each once),
`packing` and `tables` (states as whole numbers), `breadth_first`, `state_view`, `properties`,
`property_search`, `responses`, `clocks`, `witness`, `deciding`, `repeating`, `hidden`, `space` and
`exploring`.
"""

from .domains import every
from .errors import (
    DomainError,
    EndlessError,
    PredicateError,
    PropertyError,
    RepeatError,
    UnsupportedError,
    VerificationError,
)
from .exploring import explore, verify
from .members import Member
from .properties import (
    NO_FAILURE,
    Property,
    Verdict,
    always,
    leads_to,
    monitor,
    never,
    reachable,
    step,
)
from .space import Progress, Space
from .state_view import MachineView, View
from .witness import ChosenTurn, Witness

__all__ = [
    "NO_FAILURE",
    "ChosenTurn",
    "DomainError",
    "EndlessError",
    "MachineView",
    "Member",
    "PredicateError",
    "Progress",
    "Property",
    "PropertyError",
    "RepeatError",
    "Space",
    "UnsupportedError",
    "Verdict",
    "VerificationError",
    "View",
    "Witness",
    "always",
    "every",
    "explore",
    "leads_to",
    "monitor",
    "never",
    "reachable",
    "step",
    "verify",
]
