"""The names of slots on this host's board, and those under which they travel between hosts.

A host may have a name, as ``robot7``, and a list of the others' names, its `fleet`. Then:

* A slot in the folder of a host of the fleet has the same name on all hosts but that one.
* Every other slot is this host's own: ``pose`` here is ``robot7/pose`` for all others.

In slots of llfsm, ``llfsm/KIND/…``, the host follows the kind: ``llfsm/machine/Wall`` here is
``llfsm/machine/robot7/Wall`` for others, where the machine is called ``robot7/Wall``.

Both directions follow from the name alone, whichever slots there are, and each undoes the other. A
name for which that would not hold has no counterpart, and such a slot does not travel: what is in
a folder of the host's own name here, and what is of no host of the fleet there. A host without a
name has the names that travel.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from fnmatch import translate
from functools import lru_cache
from typing import TypeVar

import msgspec
from msgspec.structs import replace

from llfsm.whiteboard.errors import NetworkError
from llfsm.whiteboard.messages.llfsm import WILLS, LastWill
from llfsm.whiteboard.mirror.batches import Declaration, Value
from llfsm.whiteboard.slot_names import OWN

T = TypeVar("T", Value, Declaration)

_HOST_NAME = re.compile(r"(?!llfsm$)[A-Za-z0-9][A-Za-z0-9_.-]{0,63}")
_MAX_BYTES = 255  # of a slot's name
_WILL = msgspec.msgpack.Decoder(LastWill)


def require_host_name(name: str) -> None:
    """Raise ``ValueError`` for what cannot be a host's name."""
    if not _HOST_NAME.fullmatch(name):
        raise ValueError(
            f"{name!r} cannot be the name of a host (`as`): use 1 to 64 letters, digits, `_`, `.` "
            f"and `-`, first a letter or a digit, but not `llfsm`"
        )


class Naming:
    """Converts names of slots between the board of `host`, which may have no name, and the others.

    Raise :class:`.NetworkError` for a fleet without a name, which would have no effect.
    """

    def __init__(self, host: str = "", fleet: tuple[str, ...] = ()) -> None:
        if fleet and not host:
            what = "fleet: a host that has others in its fleet needs a name: `as`"
            raise NetworkError(what, ("fleet",))
        self.host = host
        self._is_other = re.compile("|".join(map(translate, fleet)) or r"(?!)").match
        self.wire = lru_cache(maxsize=8192)(self._wire)
        """Return the name for all others of a slot here; None if it has none."""
        self.local = lru_cache(maxsize=8192)(self._local)
        """Return the name here of a slot that travels; None if it has none."""

    def is_own(self, local: str) -> bool:
        """Check that a slot on this board is this host's own; without a name, all are."""
        return not self.host or self.wire(local) != local

    def owner(self, local: str) -> str:
        """Return the name of the host whose own a slot on this board is; empty if it has none.

        For a host without a name, the first folder is one.
        """
        wire = self.wire(local)
        return "" if wire is None else _host_in(_split(wire)[1])[0]

    def _wire(self, local: str) -> str | None:
        if not self.host:
            return local
        kind, rest = _split(local)
        host, _ = _host_in(rest)
        if host == self.host or local == kind:
            return None
        if host and self._is_other(host):
            return local
        wire = f"{kind}{self.host}/{rest}"
        return wire if len(wire.encode(errors="surrogateescape")) <= _MAX_BYTES else None

    def _local(self, wire: str) -> str | None:
        if not self.host:
            return wire
        kind, rest = _split(wire)
        host, what = _host_in(rest)
        local = wire
        if host == self.host:
            local = kind + what if what else kind.removesuffix("/")
        return local if local and self._wire(local) == wire else None

    def why_none(self, local: str) -> str:
        """Explain why a slot here has no name for other hosts, with the remedy."""
        if _host_in(_split(local)[1])[0] == self.host:
            return (
                f"slot {local!r} does not leave, as this host is {self.host}: its own slots have "
                f"that name for others only; leave it out"
            )
        return f"slot {local!r} does not leave: with {self.host}/, its name is too long, or taken"

    def leaving(self, item: T) -> T:
        """Rename a message or a declaration that leaves, to its slot's name for others."""
        if not self.host:
            return item
        return self._renamed(item, item.slot, self.wire(item.slot), self.wire)

    def arriving(self, item: T) -> T | None:
        """Rename one that has arrived, to its slot's name here; None if that has none."""
        if not self.host:
            return item
        local = self.local(item.slot)
        return None if local is None else self._renamed(item, local, local, self.local)

    def _renamed(self, item: T, local: str, name: str | None, of: Callable[[str], str | None]) -> T:
        """Give an item another name; an own last will names slots, which change, too.

        In other hosts' wills, names are as they travel: this host may pass them on to one that has
        a slot for which there is no name here. A guard that executes them converts them (`will`).
        """
        if name is None:
            return item
        if isinstance(item, Value) and local.startswith(WILLS) and self.is_own(local):
            try:
                will = _renamed_will(_WILL.decode(item.payload), lambda slot: of(slot) or slot)
            except (msgspec.DecodeError, ValueError):  # something else, whatever its name
                return replace(item, slot=name)
            return replace(item, slot=name, payload=msgspec.msgpack.encode(will))
        return replace(item, slot=name)

    def will(self, slot: str, will: LastWill) -> LastWill:
        """Convert the names in a last will from a slot here, for a guard that executes it here.

        A value for a slot that has no name here is left out.
        """
        if self.is_own(slot):
            return will
        known = tuple(value for value in will.values if self.local(value.slot))
        return _renamed_will(replace(will, values=known), lambda name: self.local(name) or name)


def _renamed_will(will: LastWill, rename: Callable[[str], str]) -> LastWill:
    values = tuple(replace(value, slot=rename(value.slot)) for value in will.values)
    return replace(will, values=values)


def _split(name: str) -> tuple[str, str]:
    """Split a name at the place of a host's folder: ``llfsm/machine/Wall`` before ``Wall``."""
    if not name.startswith(OWN):
        return "", name
    kind, _, rest = name.removeprefix(OWN).partition("/")
    return f"{OWN}{kind}/", rest


def _host_in(rest: str) -> tuple[str, str]:
    """Split off the first folder, or "" if there is none."""
    host, slash, what = rest.partition("/")
    return (host, what) if slash else ("", rest)
