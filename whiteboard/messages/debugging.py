"""What a debugger publishes of machines."""

from functools import lru_cache

from ..message import Message
from ..slots import Slot, legal_name

__all__ = ["WHYS", "MachineWhy", "SeenTransition", "why_slot"]

WHYS = "llfsm/why/"


class SeenTransition(Message):
    """A transition as it was evaluated, or would be; no value if that takes a call with effects.

    `seen` is its expression with the values of its parts; "not evaluated" if one before it has
    fired, or has raised.
    """

    target: str
    label: str
    value: bool | None
    seen: str


class MachineWhy(Message):
    """Why a machine is in `state`: its transitions; posted for a viewer.

    They are as they were evaluated `evaluated_s` seconds before the message's stamp, by the
    machine's clock; without a time, as they would be then, on the last snapshot. While paused
    where a transition has fired, from `source`, `before` are those of that state; it is the one
    whose code has raised if the machine has `failed` there. The `breakpoints` are those of all
    machines of its process; `problem` is why the last request was refused.
    """

    state: str
    transitions: tuple[SeenTransition, ...]
    source: str = ""
    before: tuple[SeenTransition, ...] = ()
    breakpoints: tuple[str, ...] = ()
    problem: str = ""
    evaluated_s: float | None = None
    failed: bool = False


@lru_cache(maxsize=128)
def why_slot(machine: str) -> Slot[MachineWhy]:
    """Return the slot for why a machine is in its state."""
    return Slot(WHYS + legal_name(machine), MachineWhy, 16 << 10)
