"""What other processes request of a debugger: a page, or a command."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from llfsm.errors import LlfsmError
from llfsm.runtime.engine.failure import logger

if TYPE_CHECKING:
    from llfsm.whiteboard.messages.llfsm import MachineRequest

    from .debugger import Debugger

__all__ = ["LEASE_S", "obey"]

LEASE_S: Final = 60.0
"""How long a pause or an override from outside lasts that nobody renews."""


def obey(debugger: Debugger, request: MachineRequest, machine: str) -> None:
    """Do what another process requests of the arrangement that runs `machine`.

    Why that is refused is the debugger's `problem` then.
    """
    if request.action == "renew":
        debugger.renew(request.lease_s)
        return
    debugger.problem = ""
    try:
        _obey(debugger, request, machine)
    except LlfsmError as error:
        logger().warning("%s was not obeyed: %s: %s", request.action, machine, error)
        debugger.problem = str(error)


def _obey(debugger: Debugger, request: MachineRequest, machine: str) -> None:
    lease_s, argument = request.lease_s or LEASE_S, request.argument
    present = debugger.breakpoints
    match request.action:
        case "continue":
            debugger.proceed()
        case "pause":
            debugger.pause("pause", lease_s=lease_s)
        case "step":
            debugger.step(argument, machine, lease_s=lease_s)  # type: ignore[arg-type]  # it is checked
        case "break" if argument not in present:
            debugger.break_at(*present, argument)
            debugger.leases[argument] = lease_s
        case "clear":
            debugger.break_at(*(each for each in present if each != argument))
        case "override":
            sensor, _, text = argument.partition(" ")
            debugger.override(machine, sensor, text, lease_s=lease_s)
        case "release":
            debugger.arrangement.release(machine, argument)
