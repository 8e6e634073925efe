"""What failures say of an arrangement and of functions."""

from __future__ import annotations

from collections.abc import Iterable

from ..engine.arrangement import Arrangement
from ..engine.machine import Machine

__all__ = ["name_of", "standing"]


def standing(arrangement: Arrangement, machines: Iterable[Machine]) -> str:
    """Return a line for each machine, each after a line break: where it is, and since when."""
    now_ns = arrangement.clock.now_ns()
    return "".join(f"\n  {_place(machine, now_ns)}" for machine in machines) or "\n  no machines"


def _place(machine: Machine, now_ns: int) -> str:
    seat = machine._seat
    status = seat.standing()
    text = f"{status.machine}: {status.state}"
    if status.entered_ns is None or seat.current is not seat.previous:
        text += ", not yet entered"
    else:
        text += f" for {(now_ns - status.entered_ns) / 1e6:g} ms"
    if status.suspended:
        text += ", suspended"
    if status.request is not None:
        text += f", to {status.request}"
    return text if seat.taken else f"{text}, unloaded"


def name_of(function: object, default: str) -> str:
    """Return the name of a function or class as code would write it; `default` for a lambda."""
    name = str(getattr(function, "__qualname__", default)).rpartition("<locals>.")[2]
    return default if "<" in name else name
