"""``llfsm bridge ros2``: relays and services, from a file or from flags."""

from __future__ import annotations

from pathlib import Path

import click

from llfsm.bridges.ros2.bridging.bridge_config import Direction, RelayConfig

from ..ros_options import BridgeOptions, RosCommand, bridge_options
from .configured import Configured
from .running import run_bridge

__all__ = ["ros2"]


@click.command(cls=RosCommand)
@click.option(
    "--config",
    "file",
    metavar="FILE",
    type=click.Path(path_type=Path),
    help="What to connect, as TOML; see docs/how-to/ros2.md.",
)
@click.option(
    "--to-ros",
    metavar="SLOT:TYPE",
    multiple=True,
    help="Publish a slot's messages on the topic of its name, such as pinpong:std_msgs/msg/String. "
    "May be repeated, as may the next two.",
)
@click.option(
    "--from-ros",
    metavar="TOPIC:TYPE",
    multiple=True,
    help="Add a topic's messages to the slot of its name, such as turtle1/pose:turtlesim/msg/Pose.",
)
@click.option("--both", metavar="NAME:TYPE", multiple=True, help="Do both; nothing is echoed.")
@bridge_options
def ros2(
    file: Path | None,
    to_ros: tuple[str, ...],
    from_ros: tuple[str, ...],
    both: tuple[str, ...],
    options: BridgeOptions,
) -> None:
    """Relay messages between slots and topics, and serve services, until Ctrl-C.

    It is a ROS node, and takes arguments of ROS after --ros-args.

    \b
    llfsm bridge ros2 --config bridge.toml
    llfsm bridge ros2 --to-ros pinpong:std_msgs/msg/String --from-ros pose:turtlesim/msg/Pose
    """
    flags = [
        *_relays("--to-ros", to_ros, "to_ros"),
        *_relays("--from-ros", from_ros, "from_ros"),
        *_relays("--both", both, "both"),
    ]
    if file is None and not flags:
        raise click.UsageError("nothing to connect: give --config, --to-ros, --from-ros or --both")
    run_bridge(Configured.read(file, flags), options)


def _relays(
    option: str, texts: tuple[str, ...], direction: Direction
) -> list[tuple[str, RelayConfig]]:
    relays = []
    for text in texts:
        name, colon, type_name = text.partition(":")
        if not (name and colon and type_name):
            raise click.UsageError(f"{option} {text}: write NAME:TYPE, as pose:turtlesim/msg/Pose")
        relay = RelayConfig(slot=name.lstrip("/"), topic=name, type=type_name, direction=direction)
        relays.append((f"{option} {text}", relay))
    return relays
