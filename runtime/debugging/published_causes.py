"""Why a machine is in its state, as a message for other processes."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

from llfsm.whiteboard.messages.debugging import MachineWhy, SeenTransition

from .debugger import Debugger

if TYPE_CHECKING:
    from llfsm.runtime.engine.arrangement import Arrangement

    from .causes import Cause

__all__ = ["why_of"]


def why_of(arrangement: Arrangement, machine: str, now_ns: int) -> MachineWhy:
    """Return why a machine is in its state at `now_ns` of the arrangement's clock."""
    debugger = Debugger.of(arrangement)
    found = debugger.sight(machine, now_ns)
    before, evaluated_ns = found.before, found.evaluated_ns
    return MachineWhy(
        found.state,
        _seen(found.causes),
        before.source if before else "",
        _seen(before.causes) if before else (),
        debugger.breakpoints,
        debugger.problem,
        None if evaluated_ns is None else (now_ns - evaluated_ns) / 1e9,
        before is not None and not before.target,
    )


def _seen(causes: Iterable[Cause]) -> tuple[SeenTransition, ...]:
    return tuple(SeenTransition(*cause) for cause in causes)
