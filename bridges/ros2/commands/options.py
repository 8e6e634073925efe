"""The options of commands that run a bridge, and what they say."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import click

from llfsm.runtime.commands.board import board_option
from llfsm.runtime.commands.supervised import supervised_options

from ..opening import WAYS, explained, open_port
from ..port import Notice, Port

__all__ = ["Ways", "bridge_options"]


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
        if not self.router:
            return open_port(self.port, self.domain, notify=notify)
        if self.port == "rclpy":
            raise click.UsageError("--router is for --port zenoh: rclpy has its own configuration")
        with explained():
            from ..wire.port import ZenohPort
        return ZenohPort(self.domain, router=self.router, notify=notify)


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
        click.option(
            "--router",
            metavar="ENDPOINT",
            multiple=True,
            help="Where a Zenoh router is, as tcp/192.168.1.5:7447.  [default: this host]",
        ),
        click.option(
            "--domain",
            metavar="ID",
            type=click.IntRange(0, 232),
            help="The ROS domain.  [default: $ROS_DOMAIN_ID, else 0]",
        ),
        click.option(
            "--port",
            type=click.Choice(WAYS),
            default="auto",
            show_default=True,
            help="The way into ROS; auto is rclpy where it is installed.",
        ),
    ):
        optioned = option(optioned)
    return optioned
