"""The groups of slots: what travels together, and what a host reads or does not read.

A group is a folder: the slots whose names are equal up to the last ``/``. Slots that are read
together are mostly in one folder, as ``robot7/arm/angle`` and ``robot7/arm/speed`` are, and so one
message carries all that changed among them. With a key for each slot, each would need a message of
its own; with a fixed number of groups, each would bring a share of what everybody publishes, and
that grows with the hosts.

In a key, a folder is a hash of its name: names have characters that keys do not have.
"""

from __future__ import annotations

from functools import lru_cache
from hashlib import blake2b

__all__ = ["EVERY_GROUP", "group_of"]

EVERY_GROUP = ""
"""In place of a group: all of them."""


@lru_cache(maxsize=8192)
def group_of(slot: str) -> str:
    """Return the group of a slot."""
    folder = slot.rpartition("/")[0].encode(errors="surrogateescape")
    return blake2b(folder, digest_size=8).hexdigest()
