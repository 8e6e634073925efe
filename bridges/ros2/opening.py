"""Opens a transport by its name, or a Zenoh router in this process, in place of rmw_zenohd.

A transport's library is imported when it is opened. Another transport is a module that implements
:mod:`.transport`, its name in :data:`.defaults.TRANSPORTS` and a branch of :func:`open_transport`.
"""

from __future__ import annotations

import ctypes
import importlib.util
import os
import re
import socket
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING

from llfsm.bridges.ros2.defaults import TRANSPORTS
from llfsm.bridges.ros2.errors import TransportUnavailableError
from llfsm.bridges.ros2.transport import Notice, Transport, log_notice
from llfsm.whiteboard.mirror.settings import PORT, endpoint_problem

if TYPE_CHECKING:
    import zenoh


def open_transport(
    name: str = "auto",
    domain: int | None = None,
    *,
    router: Sequence[str] = (),
    enclave: str = "",
    notify: Callable[[Notice], None] = log_notice,
) -> Transport:
    """Open a transport: ``rclpy``, ``zenoh``, or ``auto`` (see :func:`.choose_transport`).

    ``domain`` defaults to ``ROS_DOMAIN_ID``. ``router`` names Zenoh endpoints, as
    ``tcp/localhost:7447``; ``enclave`` is the security enclave of the nodes. Raise
    :class:`.TransportUnavailableError` and :class:`.DomainIdError`.
    """
    chosen = choose_transport(name, router=bool(router))
    if chosen == "rclpy":
        with explaining_missing():
            from llfsm.bridges.ros2.rclpy_transport.transport import RclpyTransport

            return RclpyTransport(domain, enclave=enclave, notify=notify)
    if chosen == "zenoh":
        with explaining_missing():
            from llfsm.bridges.ros2.zenoh_transport.transport import ZenohTransport

            return ZenohTransport(domain, router=router or None, enclave=enclave, notify=notify)
    known = ", ".join(TRANSPORTS)
    raise TransportUnavailableError(f"unknown transport {name!r}: not one of {known}")


def choose_transport(name: str, *, router: bool) -> str:
    """Choose ``rclpy`` or ``zenoh`` for ``auto``; return any other name as it is.

    It is rclpy where that can be imported, as its nodes may use any middleware; but Zenoh if a
    ``router`` is named, because rclpy has its own configuration.
    """
    if name != "auto":
        return name
    return "zenoh" if router or importlib.util.find_spec("rclpy") is None else "rclpy"


def needs_router(name: str, *, router: bool) -> bool:
    """Check if nodes on a transport find each other through a Zenoh router."""
    if choose_transport(name, router=router) == "zenoh":
        return True
    return os.environ.get("RMW_IMPLEMENTATION") == "rmw_zenoh_cpp"


_EXTRA = "install it with: pip install 'llfsm[ros]'"
_GET = {
    "zenoh": _EXTRA,
    "xxhash": _EXTRA,
    "rclpy": "source a ROS 2 environment that has it, as: source /opt/ros/jazzy/setup.bash",
}


@contextmanager
def explaining_missing() -> Iterator[None]:
    """Raise :class:`.TransportUnavailableError` for a missing library, with how to get it."""
    try:
        yield
    except ModuleNotFoundError as error:
        how = _GET.get((error.name or "").partition(".")[0])
        if how is None:
            raise
        raise TransportUnavailableError(f"{error.name} is not installed; {how}") from error


_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3  # of <malloc.h>
_KEPT = 64 << 20  # bytes
_LARGEST = 32 << 20  # the most that glibc accepts


def keep_freed_memory() -> None:
    """Let this process keep up to 64 MB of freed memory; without glibc, do nothing.

    For programs that relay messages; a library leaves it to the program that uses it. glibc returns
    large blocks to the system when they are freed. Each copy of a large message, such as an image
    or a cloud of points, then finds its memory empty, page by page, which takes several times as
    long as the copying.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(_MMAP_THRESHOLD, _LARGEST)
        mallopt(_TRIM_THRESHOLD, _KEPT)


_LOOPBACK = re.compile(r"tcp/(localhost|127\.0\.0\.1|\[::1\]):(\d+)")


def loopback(port: int = PORT) -> list[str]:
    """List the endpoints that only this host reaches, on IPv6 too if it has that."""
    endpoints = [f"tcp/127.0.0.1:{port}"]
    try:
        with socket.socket(socket.AF_INET6) as probe:
            probe.bind(("::1", 0))
    except OSError:
        return endpoints
    return [*endpoints, f"tcp/[::1]:{port}"]


def loopback_address(endpoint: str) -> tuple[str, int] | None:
    """Split an endpoint that only this host reaches into host and port; None for others."""
    match = _LOOPBACK.fullmatch(endpoint)
    return match and (match[1].strip("[]"), int(match[2]))


def serves(address: tuple[str, int]) -> bool:
    """Check if a program accepts TCP connections at a host and port."""
    try:
        with socket.create_connection(address, timeout=1.0):
            return True
    except (OSError, OverflowError):  # the latter if the port's number is too large
        return False


def open_router(listen: Sequence[str]) -> zenoh.Session:
    """Start a router in this process; it ends when the session is closed.

    Raise :class:`.TransportUnavailableError` if it cannot listen on one of the endpoints, or if
    Zenoh is not installed.
    """
    for problem in filter(None, map(endpoint_problem, listen)):
        raise TransportUnavailableError(f"no router: {problem}")
    with explaining_missing():
        from llfsm.bridges.ros2.zenoh_transport.transport import open_with
    settings = {
        "mode": "router",
        "listen/endpoints": list(listen),
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": True,
    }
    try:
        return open_with(settings)
    except TransportUnavailableError as error:
        raise TransportUnavailableError(
            f"no router on {', '.join(listen)}: {error}{_hint(listen)}"
        ) from error


def _hint(listen: Sequence[str]) -> str:
    """Name a program that may occupy an endpoint: the default port is that of two of ours."""
    taken = [e for e in listen if (address := loopback_address(e)) and serves(address)]
    if not taken:
        return ""
    return (
        f"; {taken[0]} is in use, perhaps by another router or by `llfsm whiteboard daemon`: "
        "give one of them another endpoint with --listen"
    )
