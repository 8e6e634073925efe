"""Why a machine is in its state, as a message for other processes."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

from llfsm.whiteboard.messages.debugging import MachineWhy, SeenTransition

from .causes import Cause, why
from .debugger import Debugger

if TYPE_CHECKING:
    from llfsm.runtime.engine.arrangement import Arrangement

__all__ = ["why_of"]


def why_of(arrangement: Arrangement, machine: str, now_ns: int) -> MachineWhy:
    """Return why a machine is in its state at `now_ns` of the arrangement's clock."""
    standing, arrival = arrangement.standing(machine), arrangement.arrival(machine)
    elapsed_ns = None if arrival.entered_ns is None else now_ns - arrival.entered_ns
    found = why(arrangement.machine(machine), standing.state, elapsed_ns)
    debugger = arrangement.instrument
    if not isinstance(debugger, Debugger):
        return MachineWhy(standing.state, _seen(found))
    fired = debugger.fired
    has_fired = fired is not None and fired.machine == machine
    return MachineWhy(
        standing.state,
        _seen(found),
        fired.source if fired and has_fired else "",
        _seen(fired.causes) if fired and has_fired else (),
        debugger.breakpoints,
        debugger.problem,
    )


def _seen(causes: Iterable[Cause]) -> tuple[SeenTransition, ...]:
    return tuple(SeenTransition(*cause) for cause in causes)
