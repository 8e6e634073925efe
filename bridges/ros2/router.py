"""A Zenoh router in this process, in place of rmw_zenohd."""

from __future__ import annotations

import re
import socket
from collections.abc import Sequence
from typing import TYPE_CHECKING

from llfsm.whiteboard.mirror.endpoint_syntax import PORT, endpoint_problem

from .errors import RouterError, TransportUnavailableError
from .opening import explaining_missing

if TYPE_CHECKING:
    import zenoh

__all__ = ["loopback", "loopback_address", "open_router", "serves"]

_LOOPBACK = re.compile(r"tcp/(localhost|127\.0\.0\.1|\[::1\]):(\d+)")


def loopback(port: int = PORT) -> list[str]:
    """Return the endpoints that only this host reaches, on IPv6 too if it has that."""
    endpoints = [f"tcp/127.0.0.1:{port}"]
    try:
        with socket.socket(socket.AF_INET6) as probe:
            probe.bind(("::1", 0))
    except OSError:
        return endpoints
    return [*endpoints, f"tcp/[::1]:{port}"]


def loopback_address(endpoint: str) -> tuple[str, int] | None:
    """Return the host and port of an endpoint that only this host reaches, else None."""
    match = _LOOPBACK.fullmatch(endpoint)
    return match and (match[1].strip("[]"), int(match[2]))


def serves(address: tuple[str, int]) -> bool:
    """Return whether something accepts TCP connections at a host and port."""
    try:
        with socket.create_connection(address, timeout=1.0):
            return True
    except (OSError, OverflowError):  # the latter if the port's number is too large
        return False


def open_router(listen: Sequence[str]) -> zenoh.Session:
    """Start a router in this process; it ends when the session is closed.

    Raise :class:`.RouterError` if it cannot listen on one of the endpoints, and
    :class:`.TransportUnavailableError` if Zenoh is not installed.
    """
    for problem in filter(None, map(endpoint_problem, listen)):
        raise RouterError(f"no router: {problem}")
    with explaining_missing():
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
        raise RouterError(f"no router on {', '.join(listen)}: {error}{_hint(listen)}") from error


def _hint(listen: Sequence[str]) -> str:
    """Return what may occupy an endpoint; the default port is that of two programs of ours."""
    taken = [e for e in listen if (address := loopback_address(e)) and serves(address)]
    if not taken:
        return ""
    return (
        f"; {taken[0]} is in use, perhaps by another router or by `llfsm whiteboard daemon`: "
        "give one of them another endpoint with --listen"
    )
