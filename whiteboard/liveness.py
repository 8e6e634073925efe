"""Whether a process lives. A number alone does not tell: the system uses it again one day."""

from __future__ import annotations

import os
import socket
import time
from functools import cache
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .slots import Sample

__all__ = ["born", "host_name", "lives", "writer_lives"]

_TICKS_PER_S = os.sysconf("SC_CLK_TCK")


@cache
def host_name() -> str:
    """Return the name of this host."""
    return socket.gethostname()


def born(pid: int) -> int:
    """Return when a process started, in clock ticks since the host booted; 0 if it is dead."""
    try:
        with open(f"/proc/{pid}/stat", "rb") as file:
            # The name, in parentheses, may contain anything: what comes after it begins with
            # the third field, the state, and the start is the twenty-second.
            state, *fields = file.read().rpartition(b")")[2].split()
    except OSError:
        return 0
    return 0 if state == b"Z" else int(fields[18])


def lives(pid: int, started: int) -> bool:
    """Return whether the process that started at `started` (see `born`) still runs."""
    return started != 0 and born(pid) == started


def writer_lives(sample: Sample[Any]) -> bool:
    """Return whether the process that added a message still runs; one started later did not."""
    started = born(sample.writer)
    if started == 0:
        return False
    # Stamps leave out the time for which the host was suspended, the start of a process does not.
    suspended_ns = time.clock_gettime_ns(time.CLOCK_BOOTTIME) - time.monotonic_ns()
    return started * 1_000_000_000 // _TICKS_PER_S <= sample.stamp_ns + suspended_ns
