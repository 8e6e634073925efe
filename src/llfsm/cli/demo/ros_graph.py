"""A demo on ROS 2: the graph that its nodes are in, and the processes that it needs for that."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import click

from llfsm.bridges.ros2.defaults import ROUTER, TRANSPORTS
from llfsm.bridges.ros2.opening import loopback_address, needs_router, serves
from llfsm.bridges.ros2.transport import default_domain
from llfsm.cli.demo.parts import Processes
from llfsm.cli.options import BoardPlace, Command, collected
from llfsm.cli.ros_options import domain_option, require_ros, router_option, transport_option

_DOMAIN = 99  # hardly used elsewhere; the highest that DDS supports on every system is 101
_LOOK_S = 0.05


class RosGraph(NamedTuple):
    """The graph of ROS nodes that a demo is part of.

    With a simulator of its own the demo stays apart from other nodes: in a domain of its own, and
    on this host. Without one it joins the graph that has a simulator.
    """

    transport: str = TRANSPORTS[0]
    domain: int | None = None
    router: str | None = None
    simulator: bool = True

    def __str__(self) -> str:
        domain = self._domain()
        return f"ROS domain {default_domain() if domain is None else domain}"

    def environment(self) -> Mapping[str, str]:
        """Return the variables that keep DDS from discovering nodes on the network."""
        return {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"} if self.simulator else {}

    def start_router(
        self, processes: Processes, serves: Callable[[tuple[str, int]], bool] = serves
    ) -> None:
        """Start a router if the nodes need one on this host and none listens there."""
        address = loopback_address(self.router or ROUTER)
        if address is None or not needs_router(self.transport, router=self.router is not None):
            return
        if serves(address):
            return
        listen = () if self.router is None else ("--listen", self.router)
        processes.start("router", "router", *listen)
        while not serves(address):
            processes.wait(_LOOK_S)

    def start_simulator(self, processes: Processes, picture: Path) -> None:
        """Start the simulator, unless the demo uses another."""
        if self.simulator:
            options = ("--ros", *self._options())
            processes.start("simulator", "turtlesim", *options, "--picture", str(picture))

    def start_bridge(self, processes: Processes, board: BoardPlace) -> None:
        """Start the bridge; it removes the board if this process is killed."""
        on_board = (*board.arguments, "--remove-board")
        processes.start("bridge", "bridge", "turtlesim", "--quiet", *self._options(), *on_board)

    def _domain(self) -> int | None:
        return _DOMAIN if self.domain is None and self.simulator else self.domain

    def _options(self) -> list[str]:
        options = ["--transport", self.transport]
        domain = self._domain()
        if domain is not None:
            options += ["--domain", str(domain)]
        if self.router is not None:
            options += ["--router", self.router]
        return options


def graph_options(command: Command) -> Command:
    """Add the options of a :class:`RosGraph`, which reach the command as ``graph``, and ``--ros``.

    Without ``--ros``, ``graph`` is None and the other options are refused.
    """

    def graph_of(ros: bool, *options: Any) -> RosGraph | None:
        require_ros(*RosGraph._fields, ros=ros)
        return RosGraph(*options) if ros else None

    optioned = collected(command, "graph", graph_of, ("ros", *RosGraph._fields))
    for option in (
        click.option(
            "--no-simulator",
            "simulator",
            flag_value=False,
            default=True,
            help="Use turtlesim_node, which you start, instead of our simulator (with --ros).",
        ),
        router_option(
            " (with --ros)",
            "; one is started if that is on this host and nothing listens there",
            ROUTER,
            multiple=False,
        ),
        domain_option(
            " (with --ros)",
            f"{_DOMAIN}, apart from other nodes; with --no-simulator $ROS_DOMAIN_ID, else 0",
        ),
        transport_option(" (with --ros)"),
        click.option(
            "--ros",
            is_flag=True,
            help="Run the simulator as a ROS 2 node, and a bridge; dead processes are restarted.",
        ),
    ):
        optioned = option(optioned)
    return optioned
