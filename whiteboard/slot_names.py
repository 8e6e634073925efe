"""The names of slots: which are llfsm's own, and those made from other names."""

from __future__ import annotations

import re
from zlib import crc32

OWN = "llfsm/"
"""The folder of the slots in which llfsm's own processes find each other."""

KEEPS_READ = "/."
"""The end of the name of a slot that never has a message: who reads it reads its folder."""

_MAX_PART = 230  # bytes of another name that fit into a slot's name


def is_own(name: str) -> bool:
    """Check that a slot is one of llfsm's own."""
    return name.startswith(OWN)


def is_users(name: str) -> bool:
    """Check that a slot is for users: neither llfsm's own, nor there to keep a folder read."""
    return not name.startswith(OWN) and not name.endswith(KEEPS_READ)


def legal_name(name: str) -> str:
    """Make the name of a machine or slot fit into a slot's name; distinct ones stay distinct.

    Blanks and control characters become ``_``. A name of over 230 bytes is cut, and ends with a
    checksum of all of it.
    """
    visible = re.sub(r"[\s\x00-\x1f\x7f]", "_", name).encode("utf-8", "replace")
    if len(visible) > _MAX_PART:
        visible = visible[: _MAX_PART - 9] + b"~%08x" % crc32(visible)
    return visible.decode("utf-8", "ignore")
