"""TCP ports on which nobody listens, and which nobody gets before the test that asked for one.

They are outside the range from which the system takes ports for connections, and each worker of the
test run takes its own part.
"""

from __future__ import annotations

import itertools
import os
import socket

__all__ = ["free_endpoint", "free_port"]

_FIRST, _EACH, _PARTS = 10_000, 2_000, 10

_part = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw")) % _PARTS
_offsets = itertools.count(os.getpid() * 7)  # another run of the tests may go on beside this one


def free_port() -> int:
    """Return a free port of the loopback."""
    for offset in itertools.islice(_offsets, _EACH):
        port = _FIRST + _part * _EACH + offset % _EACH
        with socket.socket() as probe:
            try:
                probe.bind(("127.0.0.1", port))
            except OSError:
                continue
        return port
    raise AssertionError("no port is free")


def free_endpoint(address: str = "127.0.0.1", protocol: str = "tcp") -> str:
    """Return an endpoint of Zenoh's on a free port."""
    return f"{protocol}/{address}:{free_port()}"
