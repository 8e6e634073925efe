"""What a debugger publishes of machines."""

from functools import lru_cache

from ..message import Message
from ..slots import Slot, legal_name

__all__ = ["WHYS", "MachineWhy", "SeenTransition", "why_slot"]

WHYS = "llfsm/why/"


class SeenTransition(Message):
    """A transition as it would be evaluated, or was; no value if that takes a call with effects.

    `seen` is its expression with the values of its parts.
    """

    target: str
    label: str
    value: bool | None
    seen: str


class MachineWhy(Message):
    """Why a machine is in `state`: its transitions on the last snapshot; posted for a viewer.

    At a breakpoint of a transition that has fired, from `source`, `before` are those of that state.
    The `breakpoints` are those of all machines of its process; `problem` is why the last
    request was refused.
    """

    state: str
    transitions: tuple[SeenTransition, ...]
    source: str = ""
    before: tuple[SeenTransition, ...] = ()
    breakpoints: tuple[str, ...] = ()
    problem: str = ""


@lru_cache(maxsize=128)
def why_slot(machine: str) -> Slot[MachineWhy]:
    """Return the slot for why a machine is in its state."""
    return Slot(WHYS + legal_name(machine), MachineWhy, 16 << 10)
