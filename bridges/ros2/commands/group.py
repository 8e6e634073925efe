"""``llfsm bridge``: its commands, a module each."""

from __future__ import annotations

import click

from .checking import check
from .ros2 import ros2
from .turtlesim import turtlesim

__all__ = ["bridge"]


@click.group()
def bridge() -> None:
    """Connect a whiteboard with ROS 2, with or without ROS installed.

    \b
    llfsm bridge ros2 --config bridge.toml
    llfsm bridge ros2 --to-ros pinpong:std_msgs/msg/String
    llfsm bridge check bridge.toml
    llfsm bridge turtlesim
    """


for command in (ros2, check, turtlesim):
    bridge.add_command(command)
