"""``llfsm bridge turtlesim``: what lets machines drive turtles of ROS."""

from __future__ import annotations

import click

from llfsm.bridges.ros2.bridging.bridge_config import turtlesim_config

from ..ros_options import BridgeOptions, bridge_options
from .configured import Configured
from .running import run_bridge

__all__ = ["turtlesim"]


@click.command()
@click.option(
    "--turtle",
    "turtles",
    metavar="NAME",
    multiple=True,
    default=["turtle1"],
    show_default=True,
    help="A turtle to connect; may be repeated. `turtle_position` tells of the first.",
)
@bridge_options
def turtlesim(turtles: tuple[str, ...], options: BridgeOptions) -> None:
    """Connect machines with the turtles of turtlesim_node, until Ctrl-C.

    For each turtle <turtle>/cmd_vel goes to ROS, <turtle>/pose and <turtle>/color_sensor come from
    it. The text in pinpong goes to the topic pinpong. Where the turtle is, is answered as the
    service turtle_position and in its slots.

    \b
    ros2 run turtlesim turtlesim_node
    llfsm bridge turtlesim
    llfsm run RosWallTurttleBot -v
    """
    run_bridge(Configured(turtlesim_config(turtles)), options)
