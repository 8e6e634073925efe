"""The debugger's side of requests from other processes, and its answer to "why" as a message.

A kind of request is an action of `MachineRequest` (`llfsm.whiteboard.messages.llfsm`), carried out
in `_obey` by a method of `Debugger`.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

from llfsm.errors import LlfsmError
from llfsm.runtime.debugging.debugger import Debugger
from llfsm.runtime.debugging.leases import LEASE_S
from llfsm.runtime.log import logger
from llfsm.whiteboard.messages.llfsm import MachineWhy, SeenTransition

if TYPE_CHECKING:
    from llfsm.runtime.debugging.causes import Cause
    from llfsm.runtime.engine.arrangement import Arrangement
    from llfsm.whiteboard.messages.llfsm import MachineRequest


def obey(debugger: Debugger, request: MachineRequest, machine: str) -> None:
    """Carry out a request to the arrangement that runs `machine`.

    If it is refused, the reason is logged, and becomes the debugger's `problem`.
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


def why_of(arrangement: Arrangement, machine: str, now_ns: int) -> MachineWhy:
    """Publish, as a message, why a machine is in its state at `now_ns` of its clock."""
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
