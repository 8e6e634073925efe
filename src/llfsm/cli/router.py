"""``llfsm router``: a Zenoh router for ROS 2 nodes, in place of rmw_zenohd."""

from __future__ import annotations

import signal
import threading
from types import FrameType

import click

from llfsm.bridges.ros2.router import loopback, open_router

from .options import end_with_input, until_eof_option

__all__ = ["router"]


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
    """Run a Zenoh router, through which ROS 2 nodes discover each other, until Ctrl-C.

    It replaces rmw_zenohd where ROS is not installed: nodes with
    RMW_IMPLEMENTATION=rmw_zenoh_cpp, of ROS and of llfsm, need a router.

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
    session = open_router(endpoints)
    try:
        if until_eof:
            end_with_input()
        click.echo(f"router: listening on {', '.join(endpoints)}")
        over.wait()
    finally:
        session.close()
