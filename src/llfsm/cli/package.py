"""``llfsm package``: the ROS 2 package that starts a machine."""

from __future__ import annotations

from pathlib import Path

import click

from .machine_names import find_bundle, find_machine
from .options import output_option
from .ros_package import write_package

__all__ = ["package"]


@click.command()
@click.argument("machine")
@output_option("the package")
def package(machine: str, output: Path) -> None:
    """Write the ROS 2 package that starts MACHINE, named as for `llfsm run`.

    A bundle is copied into it. A class is imported, so it must be installed where it runs.

    \b
    llfsm package RosPingPong -o ~/ros2_ws/src
    cd ~/ros2_ws && colcon build && . install/setup.sh
    ros2 launch ros_ping_pong ros_ping_pong.launch.py
    """
    cls = find_machine(machine)
    origin = find_bundle(machine) or (machine if ":" in machine else cls.table.path)
    target = write_package(cls.__name__, origin, output)
    click.echo(f"wrote {target}: ros2 run {target.name} {target.name}")
