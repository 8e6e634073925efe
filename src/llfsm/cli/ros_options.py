"""The options that choose a ROS graph, and those of commands that run a bridge."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import click

from llfsm.bridges.ros2.defaults import DOMAINS, TRANSPORTS
from llfsm.bridges.ros2.opening import open_transport
from llfsm.bridges.ros2.transport import Transport

from .options import board_option, supervised_options

__all__ = [
    "BridgeOptions",
    "Command",
    "bridge_options",
    "domain_option",
    "open_chosen",
    "ros_options",
    "transport_option",
]

Command = Callable[..., Any]


class BridgeOptions(NamedTuple):
    """Which ROS graph and which whiteboard to connect, and how to run."""

    transport: str
    domain: int | None
    router: tuple[str, ...]
    board: str
    remove_board: bool
    until_eof: bool
    quiet: bool


def bridge_options(command: Command) -> Command:
    """Add the options, which reach the command as one argument, ``options``."""

    @functools.wraps(command)
    def with_options(**arguments: Any) -> Any:
        options = BridgeOptions(**{name: arguments.pop(name) for name in BridgeOptions._fields})
        return command(**arguments, options=options)

    optioned: Command = with_options
    for option in (
        click.option("--quiet", "-q", is_flag=True, help="Print problems only, no counts."),
        supervised_options,
        board_option,
        ros_options(),
    ):
        optioned = option(optioned)
    return optioned


def open_chosen(transport: str, domain: int | None, router: tuple[str, ...]) -> Transport:
    """Open the transport that the options name; raise :class:`.TransportError`."""
    if router and transport == "rclpy":
        raise click.UsageError("--router is for --transport zenoh: rclpy has its own configuration")
    return open_transport(transport, domain, router=router)


def ros_options(only: str = "") -> Callable[[Command], Command]:
    """Return a decorator that adds the options of :func:`open_chosen`.

    ``only`` is added to their help texts, as " (with --ros)".
    """

    def add(command: Command) -> Command:
        router = click.option(
            "--router",
            metavar="ENDPOINT",
            multiple=True,
            help=f"Where a Zenoh router is{only}, as tcp/192.168.1.5:7447.  [default: this host]",
        )
        return transport_option(only)(domain_option(only)(router(command)))

    return add


def domain_option(
    only: str, default: str = "$ROS_DOMAIN_ID, else 0"
) -> Callable[[Command], Command]:
    """Return a decorator that adds ``--domain``."""
    return click.option(
        "--domain",
        metavar="ID",
        type=click.IntRange(DOMAINS[0], DOMAINS[-1]),
        help=f"The ROS domain{only}.  [default: {default}]",
    )


def transport_option(only: str) -> Callable[[Command], Command]:
    """Return a decorator that adds ``--transport``."""
    return click.option(
        "--transport",
        type=click.Choice(TRANSPORTS),
        default=TRANSPORTS[0],
        help=f"How to reach ROS{only}.  [default: auto, which is rclpy where it is installed]",
    )
