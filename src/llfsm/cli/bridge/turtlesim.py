"""``llfsm bridge turtlesim``: machines drive the turtles of a ROS 2 node."""

from __future__ import annotations

import click

from llfsm.bridges.ros2.bridging.bridge_config import turtlesim_config

from ..ros_options import BridgeOptions, RosCommand, bridge_options
from .configured import Configured
from .running import run_bridge

__all__ = ["turtlesim"]


@click.command(cls=RosCommand)
@click.option(
    "--turtle",
    "turtles",
    metavar="NAME",
    multiple=True,
    default=["turtle1"],
    show_default=True,
    help="A turtle to connect; may be repeated. `turtle_position` reports the first.",
)
@bridge_options
def turtlesim(turtles: tuple[str, ...], options: BridgeOptions) -> None:
    """Connect machines with the turtles of turtlesim_node, until Ctrl-C.

    It is a ROS node, and takes arguments of ROS after --ros-args.

    For each turtle, <turtle>/cmd_vel is published to ROS, and <turtle>/pose and
    <turtle>/color_sensor are received from it. The slot pinpong is published on the topic pinpong.
    The service turtle_position, and slots of that name, report where the first turtle is.

    \b
    ros2 run turtlesim turtlesim_node
    llfsm bridge turtlesim
    llfsm run RosWallTurttleBot -v
    """
    run_bridge(Configured(turtlesim_config(turtles)), options)
