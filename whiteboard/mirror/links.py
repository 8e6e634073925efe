"""What the connections of a session are told that Zenoh has no settings for."""

from __future__ import annotations

import os
import socket
import struct
import sys
from contextlib import suppress
from stat import S_ISSOCK
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import zenoh

__all__ = ["let_go_in_time"]

_AT_ONCE = struct.pack("ii", 0, 0)


def let_go_in_time(link: zenoh.Link, timeout_ms: int) -> None:
    """Have a connection given up after that time, and closed at once. Linux only.

    It is given up by the kernel, if what was sent is not acknowledged so long; left to itself it
    would try again for minutes, ever more rarely. And a close waits for nobody: Zenoh has it wait
    up to ten seconds until the other side has got all (eclipse-zenoh/zenoh#2350), in a thread that
    then serves no other connection, so that hosts that vanish would silence all others.
    """
    if sys.platform == "linux":
        _set(_port(link.src), _port(link.dst), timeout_ms)


def _port(locator: str) -> int:
    return int(locator.partition("?")[0].rpartition(":")[2])


def _set(here: int, there: int, timeout_ms: int) -> None:
    """Set it for the connection from that port to that one: Zenoh does not tell its socket."""
    for number in map(int, os.listdir("/proc/self/fd")):
        with suppress(OSError):  # closed since it was listed, or no connection
            if S_ISSOCK(os.fstat(number).st_mode):
                with socket.socket(fileno=os.dup(number)) as found:
                    if found.getsockname()[1:2] == (here,) and found.getpeername()[1] == there:
                        found.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _AT_ONCE)
                        found.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, timeout_ms)
