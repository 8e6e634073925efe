"""Which of two messages of a slot is newer: the whole rule.

Each message has a version, assigned once, on the host where it was added:

* Its time is the host's clock, or one nanosecond more than the version of the previous message on
  that host's board if that is later. This is a hybrid logical clock (Kulkarni et al., OPODIS 2014)
  with its counter in the nanoseconds. So an add always replaces the message that is on the board
  there, however wrong the clocks are.
* Of two versions, the one with the later time is newer; if the times are equal, the one with the
  larger host id.

A message enters a board only if its version is newer than that of the message there. Versions are
totally ordered and never change. So boards that have received the same messages, in any order and
any number of times, hold the same one, and no board ever goes back.

A version may run ahead of this host's clock by a bound, as in uhlc; one that is further ahead
counts as none. Otherwise, one message with the largest version would close its slot for good:
nothing could replace it, and what builds on it would leave the range of versions.
"""

from __future__ import annotations

from typing import Annotated

import msgspec
from msgspec import Meta

__all__ = ["Id", "Time", "Version", "succeed"]

Id = Annotated[int, Meta(ge=0, le=(1 << 63) - 1)]
Time = Annotated[int, Meta(ge=0, lt=1 << 62)]  # until the year 2116, and adding never overflows


class Version(msgspec.Struct, frozen=True, order=True, array_like=True, forbid_unknown_fields=True):
    """When and where a message was added; the larger one is newer."""

    time: Time
    """Nanoseconds since 1970, of a hybrid logical clock."""
    host: Id


def succeed(before: Version | None, wall_ns: int, host: int) -> Version:
    """Return the version of a message that `host` adds at `wall_ns` on top of another one."""
    return Version(wall_ns if before is None else max(wall_ns, before.time + 1), host)
