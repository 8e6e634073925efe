"""A place on this machine where nobody listens yet."""

from __future__ import annotations

import socket

__all__ = ["free_endpoint"]


def free_endpoint() -> str:
    """Return an endpoint of Zenoh's on a free port of the loopback."""
    with socket.create_server(("127.0.0.1", 0)) as probe:
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"
