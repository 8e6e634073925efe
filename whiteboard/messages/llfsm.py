"""What llfsm's own processes tell on a whiteboard about themselves."""

from ..message import Message
from ..slots import Slot

__all__ = ["MACHINES", "MachineStatus", "status_slot"]

MACHINES = "llfsm/machine/"


class MachineStatus(Message):
    """Where a machine stands; posted when that changes, so that the stamp tells since when."""

    state: str = ""
    suspended: bool = False
    loaded: bool = True


def status_slot(machine: str) -> Slot[MachineStatus]:
    """Return the slot on which the machine of that name is told of."""
    return Slot(MACHINES + machine, MachineStatus)
