"""Messages by which a host finds the others of its fleet, and what they have."""

from ..message import Message
from ..slots import Slot
from .llfsm import VIEWER, Viewer

__all__ = ["HOSTS", "KEEPS_READ", "Folders", "Hosts", "folders_slot", "viewer_slot"]

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
