"""The options of commands that run a bridge, and what they say."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import click

from llfsm.bridges.ros2.opening import WAYS, open_transport
from llfsm.bridges.ros2.telling import log_notice
from llfsm.bridges.ros2.transport import Notice, Transport

from .options import board_option
from .supervised import supervised_options

__all__ = ["Ways", "bridge_options", "open_way", "ros_options"]


class Ways(NamedTuple):
    """Which ROS and which whiteboard to connect, and what to tell of it."""

    transport: str
    domain: int | None
    router: tuple[str, ...]
    board: str
    remove_board: bool
    until_eof: bool
    quiet: bool

    def open_transport(self, notify: Callable[[Notice], None]) -> Transport:
        """Open the way into ROS; raise :class:`.TransportError`."""
        return open_way(self.transport, self.domain, self.router, notify)


def bridge_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options, which reach the command as one argument, ``ways``."""

    @functools.wraps(command)
    def with_ways(**arguments: Any) -> Any:
        ways = Ways(**{name: arguments.pop(name) for name in Ways._fields})
        return command(**arguments, ways=ways)

    optioned: Callable[..., Any] = with_ways
    for option in (
        click.option("--quiet", "-q", is_flag=True, help="Tell no counts, only what goes wrong."),
        supervised_options,
        board_option,
        ros_options(),
    ):
        optioned = option(optioned)
    return optioned


def open_way(
    transport: str,
    domain: int | None,
    router: tuple[str, ...],
    notify: Callable[[Notice], None] = log_notice,
) -> Transport:
    """Open the way into ROS that the options name; raise :class:`.TransportError`."""
    if router and transport == "rclpy":
        raise click.UsageError("--router is for --transport zenoh: rclpy has its own configuration")
    return open_transport(transport, domain, router=router, notify=notify)


def ros_options(only: str = "") -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Return what adds the options that say which ROS; `only` begins their help texts."""

    def add(command: Callable[..., Any]) -> Callable[..., Any]:
        for option in (
            click.option(
                "--router",
                metavar="ENDPOINT",
                multiple=True,
                help=f"{only}Where a Zenoh router is, as tcp/192.168.1.5:7447.  "
                "[default: this host]",
            ),
            click.option(
                "--domain",
                metavar="ID",
                type=click.IntRange(0, 232),
                help=f"{only}The ROS domain.  [default: $ROS_DOMAIN_ID, else 0]",
            ),
            click.option(
                "--transport",
                type=click.Choice(WAYS),
                default="auto",
                show_default=True,
                help=f"{only}The way into ROS; auto is rclpy where it is installed.",
            ),
        ):
            command = option(command)
        return command

    return add
