"""``llfsm bridge``: whiteboards and other worlds."""

from __future__ import annotations

import click

from ..lazy import LazyGroup

__all__ = ["bridge"]

_COMMANDS = {
    "ros2": (
        "llfsm.cli.bridge.ros2:ros2",
        "Relay slots and topics, and serve services.",
    ),
    "check": ("llfsm.cli.bridge.check:check", "Check a configuration for `ros2`."),
    "turtlesim": (
        "llfsm.cli.bridge.turtlesim:turtlesim",
        "Connect machines with turtlesim.",
    ),
    "gusimplewhiteboard": (
        "llfsm.cli.bridge.gusimplewhiteboard:gusimplewhiteboard",
        "Relay slots to and from a gusimplewhiteboard.",
    ),
}


@click.group(cls=LazyGroup, table=_COMMANDS)
def bridge() -> None:
    """Connect a whiteboard with ROS 2, with or without ROS installed, or with another world.

    \b
    llfsm bridge ros2 --config bridge.toml
    llfsm bridge ros2 --to-ros pinpong:std_msgs/msg/String
    llfsm bridge check bridge.toml
    llfsm bridge turtlesim
    """
