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

from llfsm.runtime.verification.domains import Member, every
from llfsm.runtime.verification.errors import (
    DomainError,
    EndlessError,
    PredicateError,
    PropertyError,
    RepeatError,
    UnsupportedError,
    VerificationError,
)
from llfsm.runtime.verification.exploring import explore, verify
from llfsm.runtime.verification.properties import (
    NO_FAILURE,
    ChosenTurn,
    MachineView,
    Property,
    Verdict,
    View,
    Witness,
    always,
    leads_to,
    monitor,
    never,
    reachable,
    step,
)
from llfsm.runtime.verification.space import Progress, Space

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
