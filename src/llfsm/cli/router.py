"""``llfsm router``: a Zenoh router for ROS 2 nodes, in place of rmw_zenohd."""

from __future__ import annotations

from contextlib import closing

import click

from llfsm.bridges.ros2.opening import loopback, open_router
from llfsm.cli.echo import echo
from llfsm.cli.options import end_with_input, until_eof_option
from llfsm.runtime.engine.realtime import StopRequest, stop_on_signals


@click.command()
@click.option(
    "--listen",
    metavar="ENDPOINT",
    multiple=True,
    help="Where to listen, such as tcp/0.0.0.0:7447 (all hosts that reach this one). May be "
    "repeated.  [default: port 7447 of this host alone]",
)
@until_eof_option
def router(listen: tuple[str, ...]) -> None:
    """Run a Zenoh router, through which ROS 2 nodes discover each other, until Ctrl-C.

    It replaces rmw_zenohd where ROS is not installed: nodes with
    RMW_IMPLEMENTATION=rmw_zenoh_cpp, of ROS and of llfsm, need a router.

    \b
    llfsm router
    llfsm router --listen tcp/0.0.0.0:7447
    """
    asked = StopRequest()
    endpoints = listen or loopback()
    with stop_on_signals(lambda _: asked.make()), closing(open_router(endpoints)):
        end_with_input()
        echo(f"router: listening on {', '.join(endpoints)}")
        asked.wait()
