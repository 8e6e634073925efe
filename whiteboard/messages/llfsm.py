"""What llfsm's own processes tell each other on a whiteboard: how machines are, and requests."""

import re
from functools import lru_cache
from typing import Literal, TypeAlias
from zlib import crc32

from ..message import Message
from ..slots import Slot

__all__ = [
    "BELL",
    "MACHINES",
    "MIRROR",
    "REQUESTS",
    "Action",
    "Bell",
    "MachineRequest",
    "MachineStatus",
    "MirrorStatus",
    "PeerStatus",
    "Refusal",
    "request_slot",
    "status_slot",
]

MACHINES = "llfsm/machine/"
REQUESTS = "llfsm/request/"

_LONGEST = 230  # bytes of a machine's name that a slot's has room for

Action: TypeAlias = Literal["suspend", "resume", "restart", "stop"]


class MachineStatus(Message):
    """How a machine is: posted when that changes, and four times a second all the same.

    `state` since `in_state_s` seconds before the message's stamp; `pending` is a request that
    takes effect at its next turn; `obeyed` is the count of the latest request seen. The process
    is number `pid` of `host`, started `born` clock ticks after that came up.
    """

    state: str = ""
    suspended: bool = False
    loaded: bool = True
    pending: str = ""
    ringlets: int = 0
    overruns: int = 0
    in_state_s: float = 0.0
    obeyed: int = 0
    pid: int = 0
    born: int = 0
    host: str = ""


class MachineRequest(Message):
    """Ask something of a machine; a later request takes an earlier one's place."""

    action: Action


class Bell(Message):
    """Tell all arrangements on a board that one of their machines is asked for something."""

    machine: str = ""


BELL = Slot("llfsm/bell", Bell)


class PeerStatus(Message):
    """Another host, as the daemon of a board sees it."""

    name: str
    host: str
    silent_s: float
    lag_ms: float  # from its sending a batch to our having it; as wrong as the clocks
    received: int  # batches
    lost: int  # batches that did not arrive


class Refusal(Message):
    """Something that did not enter the board, and how often."""

    what: str
    count: int


class MirrorStatus(Message):
    """How the daemon that mirrors a board is, once a second.

    Rates are slots a second since the last status. A conflict is a message that came from another
    host after a newer one of a third or of this host.
    """

    host: str = ""
    pid: int = 0
    slots: int = 0
    left: int = 0
    entered: int = 0
    leave_rate: float = 0.0
    enter_rate: float = 0.0
    conflicts: int = 0
    held_back: int = 0  # messages of slots that come too often, of which the newest enters later
    peers: tuple[PeerStatus, ...] = ()
    refused: tuple[Refusal, ...] = ()


MIRROR = Slot("llfsm/mirror", MirrorStatus, capacity=1 << 16)


@lru_cache(maxsize=4096)  # a slot of its own each time would be bound each time
def status_slot(machine: str) -> Slot[MachineStatus]:
    """Return the slot on which the machine of that name is told of."""
    return Slot(MACHINES + _legal(machine), MachineStatus)


@lru_cache(maxsize=4096)
def request_slot(machine: str) -> Slot[MachineRequest]:
    """Return the slot on which the machine of that name is asked for something."""
    return Slot(REQUESTS + _legal(machine), MachineRequest)


def _legal(machine: str) -> str:
    """Return what can be part of a slot's name, whatever a machine is called."""
    visible = re.sub(r"[\s\x00-\x1f\x7f]", "_", machine).encode("utf-8", "replace")
    if len(visible) > _LONGEST:  # what is cut off still tells it from others
        visible = visible[: _LONGEST - 9] + b"~%08x" % crc32(visible)
    return visible.decode("utf-8", "ignore")
