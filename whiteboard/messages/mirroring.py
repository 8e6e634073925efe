"""What the daemon that mirrors a board publishes of itself and of other hosts."""

from ..message import Message
from ..slots import Slot

__all__ = ["MIRROR", "MirrorStatus", "PeerStatus", "QuotaStatus", "Refusal"]


class PeerStatus(Message):
    """Another host, as seen by the daemon of a board."""

    name: str
    host: str
    silent_s: float
    lag_ms: float  # from sending a batch to receiving it; as accurate as the clocks
    received: int  # batches
    lost: int  # batches that did not arrive
    certificate: str = ""  # the name in it, if that is known


class QuotaStatus(Message):
    """What a host has taken of its quota, since the daemon started."""

    name: str  # in its certificate; empty for all hosts that share a quota
    slots: int  # that it has made here
    max_slots: int
    bytes: int  # of shared memory for them
    max_bytes: int
    over_rate: int  # messages of the network that were dropped


class Refusal(Message):
    """A kind of message or connection that was refused, and how often."""

    what: str
    count: int


class MirrorStatus(Message):
    """The status of the daemon that mirrors a board, published once a second.

    Rates are per second since the previous status, of slots or of bytes. A conflict is a message
    from another host that arrived after a newer one of the same slot.
    """

    host: str = ""
    pid: int = 0
    slots: int = 0
    left: int = 0
    entered: int = 0
    leave_rate: float = 0.0
    enter_rate: float = 0.0
    conflicts: int = 0
    held_back: int = 0  # messages of slots that arrive too often; the newest enters later
    peers: tuple[PeerStatus, ...] = ()
    quotas: tuple[QuotaStatus, ...] = ()
    refused: tuple[Refusal, ...] = ()
    partition_s: float = 3.0  # a host that was silent for so long counts as dead
    name: str = ""  # of the host; empty if it has none
    fleet: tuple[str, ...] = ()  # globs of the others' names
    sent_rate: float = 0.0  # bytes; a batch counts once, however many hosts read it
    received_rate: float = 0.0


MIRROR = Slot("llfsm/mirror", MirrorStatus, capacity=1 << 16)
