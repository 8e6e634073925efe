"""A Zenoh router in this process, in place of rmw_zenohd."""

from __future__ import annotations

import socket
from collections.abc import Sequence
from typing import TYPE_CHECKING

from .errors import RouterError, TransportUnavailableError
from .opening import explained

if TYPE_CHECKING:
    import zenoh

__all__ = ["loopback", "open_router"]

_PORT = 7447  # where sessions of rmw_zenoh look


def loopback(port: int = _PORT) -> list[str]:
    """Return the endpoints of this host alone, of IPv6 too if it has that."""
    endpoints = [f"tcp/127.0.0.1:{port}"]
    try:
        with socket.socket(socket.AF_INET6) as probe:
            probe.bind(("::1", 0))
    except OSError:
        return endpoints
    return [*endpoints, f"tcp/[::1]:{port}"]


def open_router(listen: Sequence[str]) -> zenoh.Session:
    """Start a router in this process; it ends when the session is closed.

    Raise :class:`.RouterError` if it cannot listen on one of the endpoints, and
    :class:`.TransportUnavailableError` if Zenoh is not installed.
    """
    with explained():
        from .zenoh_transport.session import open_with
    settings = {
        "mode": "router",
        "listen/endpoints": list(listen),
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": True,
    }
    try:
        return open_with(settings)
    except TransportUnavailableError as error:
        raise RouterError(f"no router on {', '.join(listen)}: {error}") from error
