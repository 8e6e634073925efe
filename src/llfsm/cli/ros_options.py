"""The options of commands that run a bridge, and what they say."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import click

from llfsm.bridges.ros2.opening import WAYS, open_port
from llfsm.bridges.ros2.port import Notice, Port
from llfsm.bridges.ros2.telling import log_notice

from .options import board_option
from .supervised import supervised_options

__all__ = ["Ways", "bridge_options", "open_way", "ros_options"]


class Ways(NamedTuple):
    """Which ROS and which whiteboard to connect, and what to tell of it."""

    port: str
    domain: int | None
    router: tuple[str, ...]
    board: str
    remove_board: bool
    until_eof: bool
    quiet: bool

    def open_port(self, notify: Callable[[Notice], None]) -> Port:
        """Open the way into ROS; raise :class:`.PortError`."""
        return open_way(self.port, self.domain, self.router, notify)


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
    port: str,
    domain: int | None,
    router: tuple[str, ...],
    notify: Callable[[Notice], None] = log_notice,
) -> Port:
    """Open the way into ROS that the options name; raise :class:`.PortError`."""
    if router and port == "rclpy":
        raise click.UsageError("--router is for --port zenoh: rclpy has its own configuration")
    return open_port(port, domain, router=router, notify=notify)


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
                "--port",
                type=click.Choice(WAYS),
                default="auto",
                show_default=True,
                help=f"{only}The way into ROS; auto is rclpy where it is installed.",
            ),
        ):
            command = option(command)
        return command

    return add
