"""Verify machines: explore all that they can do, and decide what must never or always hold.

    from llfsm.runtime.verification import every, never, verify

    verify(
        [Timer, Cooker],
        never(lambda v: v.Cooker.door.open and v[MOTOR].on, "no radiation"),
        period_ms=1000,
        sensors={DOOR: every(Door)},
    )

Start at `exploring`. From the bottom up: `domains` and `values`; `environment` and `ringlets` (one
ringlet from any control state), `time_model`, `system` (each ringlet once), `tables` (states as
whole numbers), `packed_states` (many of them; its twin in C is `_states.c`),
`breadth_first`; `properties`, `predicates`, `responses`, `zones`, `deciding`; `unmodelled_state`
and `space`.
"""

from llfsm.runtime.verification._exploring import ExploreOptions, explore, verify
from llfsm.runtime.verification.domains import Member, every
from llfsm.runtime.verification.errors import (
    DomainError,
    PredicateError,
    UnsupportedError,
    VerificationError,
)
from llfsm.runtime.verification.properties import (
    NO_FAILURE,
    ChosenTurn,
    MachineView,
    Property,
    PropertyError,
    Region,
    Verdict,
    View,
    Witness,
    always,
    always_possible,
    eventually_always,
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
    "ExploreOptions",
    "MachineView",
    "Member",
    "PredicateError",
    "Progress",
    "Property",
    "PropertyError",
    "Region",
    "Space",
    "UnsupportedError",
    "Verdict",
    "VerificationError",
    "View",
    "Witness",
    "always",
    "always_possible",
    "eventually_always",
    "every",
    "explore",
    "leads_to",
    "monitor",
    "never",
    "reachable",
    "step",
    "verify",
]
