"""Groups of slots: the unit of travelling and of being read; and which a host receives.

A group is a folder: the slots whose names are equal up to the last ``/``. Slots that are read
together are mostly in one folder, as ``robot7/arm/angle`` and ``robot7/arm/speed`` are, and so one
message carries all that changed among them. With a key for each slot, each would need a message of
its own; with a fixed number of groups, each would bring a share of what everybody publishes, and
that grows with the hosts. In a key, a folder is a hash of its name: names have characters that keys
do not have.

A host receives the groups that are read on it, and asks all others for each at the beginning. Later
losses are noticed: a host that is connected directly reports itself, and one that adds to a slot
shows by heartbeats that something was missed. Neither comes from a host that only has messages of
one that is gone since, if routers are between them. So all groups are asked for again after each
connection to a router, and once a minute, as routers may have lost and found each other.

The names that a host gives up are a group of their own, which each host receives that has messages
of others: what was read on it once is on its board, whoever reads it now.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import lru_cache
from hashlib import blake2b

EVERY_GROUP = ""
"""In place of a group: all of them."""
ENDED = "ended"
"""The group of the names that were given up; whoever has messages of others receives it."""

_ASK_AGAIN_NS = 60_000_000_000  # between two queries to all hosts for the groups received
_NEW_AT_ONCE = 16  # groups: a process that reads thousands must not stop this host from sending


@lru_cache(maxsize=8192)
def group_of(slot: str) -> str:
    """Return the group of a slot."""
    folder = slot.rpartition("/")[0].encode(errors="surrogateescape")
    return blake2b(folder, digest_size=8).hexdigest()


class Interest:
    """The groups that a host receives: all if it is eager, else those that are read there."""

    def __init__(self, eager: bool, now_ns: int) -> None:
        self._is_eager = eager
        self.groups = {EVERY_GROUP} if eager else set[str]()
        self.is_complete = True
        """False while some that are wanted are not received yet; see :meth:`change`."""
        self._asked: set[str] = set()
        self._again_ns = now_ns + _ASK_AGAIN_NS

    def change(self, wanted: set[str]) -> set[str]:
        """Receive these groups from now on; return the new ones, for which all hosts are asked.

        A few new ones at a time, as each takes a while: call it again for the others.
        """
        new = set(sorted(wanted - self.groups)[:_NEW_AT_ONCE])
        self.groups = (self.groups & wanted) | new
        self.is_complete = self.groups == wanted
        self._asked = (self._asked | new) & wanted
        return new

    def connect(self, to_router: bool) -> None:
        """Ask again, as hosts have just connected: an eager host, only if they are behind a router.

        All others report to it all that they have, and it asks each for what it misses.
        """
        if to_router or not self._is_eager:
            self._asked |= self.groups

    def ask(self, groups: Iterable[str]) -> None:
        """Have all hosts asked for these groups."""
        self._asked |= set(groups)

    def take(self, now_ns: int) -> list[str]:
        """Return the groups for which to ask all hosts now, once."""
        if now_ns >= self._again_ns:
            self._again_ns = now_ns + _ASK_AGAIN_NS
            self._asked |= self.groups
        asked, self._asked = sorted(self._asked), set()
        return asked
