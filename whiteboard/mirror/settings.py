"""How a board is mirrored, as a file or flags say it."""

from __future__ import annotations

import re
from collections.abc import Callable
from fnmatch import translate
from functools import lru_cache
from typing import Annotated

import msgspec
from msgspec import Meta

from ..messages.llfsm import BELL, JOURNALS, MIRROR, RECORDER

__all__ = ["DEFAULT_ENDPOINT", "Settings", "matcher"]

DEFAULT_ENDPOINT = "tcp/127.0.0.1:7447"  # Zenoh's port, which a router of ROS uses, too

_Rate = Annotated[float, Meta(gt=0, le=10_000)]


class Settings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What is mirrored, with whom and how fast."""

    listen: tuple[str, ...] | None = None
    """Zenoh endpoints; by default `DEFAULT_ENDPOINT`, or what the file `zenoh` says."""
    connect: tuple[str, ...] | None = None
    multicast: bool = False
    """Look for other hosts by multicast."""
    leave: tuple[str, ...] = ("*",)
    """Globs of the slots that others get."""
    enter: tuple[str, ...] = ("*",)
    """Globs of the slots that others may add to."""
    read_only: bool = False
    """Let nothing enter: this host's board is for others to read."""
    rate: _Rate = 100.0
    """How often a slot leaves, a second, at most."""
    rates: dict[str, _Rate] = {}
    """The same for slots by glob; the first one that matches counts."""
    largest: Annotated[int, Meta(ge=1, le=1 << 30)] = 1 << 26
    """Bytes: slots of a larger capacity do not enter."""
    zenoh: str | None = None
    """A file for Zenoh itself, in JSON5: TLS, access control, queues."""

    def pause_ns(self) -> Callable[[str], int]:
        """Return what tells how long a slot that has left stays, in nanoseconds."""
        rates = [(re.compile(translate(glob)), rate) for glob, rate in self.rates.items()]

        @lru_cache(maxsize=8192)
        def pause_ns(slot: str) -> int:
            found = (rate for pattern, rate in rates if pattern.match(slot))
            return int(1e9 / next(found, self.rate))

        return pause_ns


def matcher(globs: tuple[str, ...]) -> Callable[[str], bool]:
    """Return whether a slot's name matches one of the globs, in which ``*`` matches ``/`` too.

    What is told on a board of the board itself, or to a recorder of this host, never does.
    """
    pattern = re.compile("|".join(map(translate, globs)) or r"(?!)")
    private = {BELL.name, MIRROR.name, RECORDER.name}

    @lru_cache(maxsize=8192)
    def matches(slot: str) -> bool:
        if slot in private or slot.startswith(JOURNALS):
            return False
        return pattern.match(slot) is not None

    return matches
