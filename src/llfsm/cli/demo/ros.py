"""A demo on ROS 2: where its nodes meet, and the processes that it takes."""

from __future__ import annotations

import functools
import importlib.util
import os
import re
import socket
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import click

from .processes import Processes

__all__ = ["RosGraph", "ros_options"]

_DOMAIN = 99  # where hardly anybody is; the highest that DDS can have on every system is 101
_ROUTER = "tcp/localhost:7447"
_HERE = re.compile(r"tcp/(localhost|127\.0\.0\.1|\[::1\]):(\d+)")  # endpoints of this host
_LOOK_S = 0.05


class RosGraph(NamedTuple):
    """The graph of ROS nodes that a demo is part of.

    With a simulator of its own it keeps away from other nodes: in a domain of its own, and on this
    host. Without, it joins those who have one.
    """

    transport: str = "auto"
    domain: int | None = None
    router: str | None = None
    simulator: bool = True

    def __str__(self) -> str:
        domain = self._domain()
        return f"ROS domain {os.environ.get('ROS_DOMAIN_ID', 0) if domain is None else domain}"

    def environment(self) -> Mapping[str, str]:
        """Return what keeps nodes of DDS from looking for others on the network."""
        return {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"} if self.simulator else {}

    def start_router(self, processes: Processes) -> None:
        """Start a router if the nodes need one that would be on this host and is not there."""
        here = _HERE.fullmatch(self.router or _ROUTER)
        if here is None or not self._meets_at_router():
            return
        address = here[1].strip("[]"), int(here[2])
        if _is_served(address):
            return
        listen = () if self.router is None else ("--listen", self.router)
        processes.start("router", "router", *listen)
        while not _is_served(address):
            processes.wait(_LOOK_S)

    def start_simulator(self, processes: Processes, picture: Path) -> None:
        """Start the simulator, unless there is another."""
        if self.simulator:
            way = ("--ros", *self._way())
            processes.start("simulator", "turtlesim", *way, "--picture", str(picture))

    def start_bridge(self, processes: Processes, board: str) -> None:
        """Start the bridge; it removes the board if this process is killed."""
        on_board = ("--board", board, "--remove-board")
        processes.start("bridge", "bridge", "turtlesim", "--quiet", *self._way(), *on_board)

    def _meets_at_router(self) -> bool:
        if self.transport == "zenoh" or self.router is not None:
            return True
        if self.transport == "auto" and importlib.util.find_spec("rclpy") is None:
            return True
        return os.environ.get("RMW_IMPLEMENTATION") == "rmw_zenoh_cpp"

    def _domain(self) -> int | None:
        return _DOMAIN if self.domain is None and self.simulator else self.domain

    def _way(self) -> list[str]:
        way = ["--transport", self.transport]
        domain = self._domain()
        if domain is not None:
            way += ["--domain", str(domain)]
        if self.router is not None:
            way += ["--router", self.router]
        return way


def _is_served(address: tuple[str, int]) -> bool:
    try:
        with socket.create_connection(address, timeout=1.0):
            return True
    except (OSError, OverflowError):  # there is no port of that number
        return False


def ros_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options of a :class:`RosGraph`, which reach the command as ``graph``, and ``--ros``.

    Without that ``graph`` is None, and the others are refused.
    """

    @functools.wraps(command)
    def with_graph(ros: bool, **arguments: Any) -> Any:
        graph = RosGraph(**{name: arguments.pop(name) for name in RosGraph._fields})
        if graph != RosGraph() and not ros:
            raise click.UsageError(
                "--transport, --domain, --router and --no-simulator are for --ros"
            )
        return command(**arguments, graph=graph if ros else None)

    optioned: Callable[..., Any] = with_graph
    for option in (
        click.option(
            "--no-simulator",
            "simulator",
            flag_value=False,
            default=True,
            help="With --ros: have turtlesim_node, which you start, instead of ours.",
        ),
        click.option(
            "--router",
            metavar="ENDPOINT",
            help="With --ros: where a Zenoh router is, or is to be, if that is on this host and "
            f"nobody listens there.  [default: {_ROUTER}]",
        ),
        click.option(
            "--domain",
            metavar="ID",
            type=click.IntRange(0, 232),
            help=f"With --ros: the ROS domain.  [default: {_DOMAIN}, away from other nodes; with "
            "--no-simulator $ROS_DOMAIN_ID, else 0]",
        ),
        click.option(
            "--transport",
            type=click.Choice(["auto", "rclpy", "zenoh"]),
            default="auto",
            help="With --ros: the way into ROS.  [default: auto, which is rclpy if it is there]",
        ),
        click.option(
            "--ros",
            is_flag=True,
            help="Have a simulator that is a node of ROS 2, and a bridge; what dies starts again.",
        ),
    ):
        optioned = option(optioned)
    return optioned
