"""``llfsm router``: where nodes over Zenoh find each other, in place of rmw_zenohd."""

from __future__ import annotations

import signal
import socket
import threading
from collections.abc import Sequence
from types import FrameType
from typing import TYPE_CHECKING

import click

from llfsm.runtime.commands.supervised import end_with_input, until_eof_option

from .errors import PortUnavailableError, Ros2Error, RouterError
from .opening import explained

if TYPE_CHECKING:
    import zenoh

__all__ = ["loopback", "open_router", "router"]

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
    :class:`.PortUnavailableError` if Zenoh is not installed.
    """
    with explained():
        from .wire.session import open_with
    settings = {
        "mode": "router",
        "listen/endpoints": list(listen),
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": True,
    }
    try:
        return open_with(settings)
    except PortUnavailableError as error:
        raise RouterError(f"no router on {', '.join(listen)}: {error}") from error


@click.command()
@click.option(
    "--listen",
    metavar="ENDPOINT",
    multiple=True,
    help="Where to listen, as tcp/0.0.0.0:7447 (all hosts that reach this one). May be repeated.  "
    "[default: port 7447 of this host alone]",
)
@until_eof_option
def router(listen: tuple[str, ...], until_eof: bool) -> None:
    """Let ROS 2 nodes that use Zenoh find each other, until Ctrl-C.

    It stands in for rmw_zenohd where ROS is not installed: nodes with
    RMW_IMPLEMENTATION=rmw_zenoh_cpp, of ROS and of llfsm, need one to meet.

    \b
    llfsm router
    llfsm router --listen tcp/0.0.0.0:7447
    """
    over = threading.Event()

    def end(_: int, __: FrameType | None) -> None:
        over.set()

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, end)
    endpoints = listen or loopback()
    try:
        session = open_router(endpoints)
    except Ros2Error as error:
        raise click.ClickException(str(error)) from error
    try:
        if until_eof:
            end_with_input()
        click.echo(f"router: listening on {', '.join(endpoints)}")
        over.wait()
    finally:
        session.close()
