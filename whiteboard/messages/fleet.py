"""Messages by which a host finds the others of its fleet, and what they have."""

from ..message import Message
from ..slots import Slot
from .llfsm import VIEWER, Viewer

__all__ = [
    "HOSTS",
    "KEEPS_READ",
    "SUMMARIES",
    "Folders",
    "HostSummary",
    "Hosts",
    "MachineTrouble",
    "folders_slot",
    "summary_slot",
    "viewer_slot",
]

KEEPS_READ = "/."
"""The end of the name of a slot that never has a message: who reads it reads its folder."""

_CAPACITY = 1 << 16


class Hosts(Message):
    """The names of the hosts that can be reached; kept up to date while a process reads it."""

    names: tuple[str, ...] = ()


HOSTS = Slot("llfsm/hosts", Hosts, capacity=_CAPACITY)


class Folders(Message):
    """The folders of a named host's own slots, as others have them."""

    folders: tuple[str, ...] = ()


def folders_slot(host: str = "") -> Slot[Folders]:
    """Return the slot for the folders of a host; by default of this one, if it has a name."""
    return Slot(f"llfsm/folders/{host}/" if host else "llfsm/folders", Folders, _CAPACITY)


def viewer_slot(host: str = "") -> Slot[Viewer]:
    """Return the slot for viewers of a host's machines; by default of this one."""
    return Slot(f"{VIEWER.name}/{host}/", Viewer) if host else VIEWER


class MachineTrouble(Message):
    """A machine that does not do its work: its `condition`, as in `llfsm ps`, and why."""

    machine: str
    condition: str
    error: str = ""


class HostSummary(Message):
    """A named host in a few lines, for others that look at the fleet; published once a second.

    Rates are per second: of messages of slots that leave and enter, of bytes sent and received.
    """

    system: str = ""  # the host's name in its network
    sent_ns: int = 0  # since 1970, by its clock
    leave_rate: float = 0.0
    enter_rate: float = 0.0
    sent_rate: float = 0.0
    received_rate: float = 0.0
    refused: int = 0  # messages and connections, since its daemon started
    machines: int = 0
    troubled: int = 0  # how many of these are in trouble
    troubles: tuple[MachineTrouble, ...] = ()  # of the first of these


SUMMARIES = "llfsm/summary"
"""The slot of a host's summary on that host, and the folder of others'."""


def summary_slot(host: str = "") -> Slot[HostSummary]:
    """Return the slot for the summary of a host; by default of this one, if it has a name."""
    return Slot(f"{SUMMARIES}/{host}/" if host else SUMMARIES, HostSummary, _CAPACITY)
