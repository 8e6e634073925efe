"""TCP ports on which nobody listens, and which nobody gets before the test that asked for one.

They are outside the range from which the system takes ports for connections. Each process that runs
tests claims a part of them, so that no other gets one whose listener has not started yet, or is to
start again: neither another worker of this run, nor one of another run of the tests.
"""

from __future__ import annotations

import socket
from collections.abc import Iterator

__all__ = ["free_endpoint", "free_port"]

_FIRST, _EACH, _PARTS = 10_000, 100, 200

_claims: list[socket.socket] = []  # the system releases them when the process ends


def _claimed_ports() -> Iterator[int]:
    """Yield the ports of a part, then those of the next one; a part's first port is its claim."""
    for first in range(_FIRST, _FIRST + _PARTS * _EACH, _EACH):
        claim = socket.socket()
        try:
            claim.bind(("127.0.0.1", first))
        except OSError:
            claim.close()
            continue
        _claims.append(claim)
        yield from range(first + 1, first + _EACH)


_ports = _claimed_ports()


def free_port() -> int:
    """Return a free port of the loopback, another one each time."""
    for port in _ports:
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
