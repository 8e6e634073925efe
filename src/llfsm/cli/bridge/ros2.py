"""``llfsm bridge ros2``: relays and services, from a file or from flags.

``llfsm bridge turtlesim``: machines drive the turtles of a ROS 2 node.

``llfsm bridge check``: the faults of a bridge's configuration.
"""

from __future__ import annotations

import sys
from pathlib import Path

import click

from llfsm.bridges.ros2.bridging.bridge_config import Direction, RelayConfig, turtlesim_config
from llfsm.cli.bridge.configured import Configured, slots_on
from llfsm.cli.bridge.running import run_bridge
from llfsm.cli.options import BoardPlace, board_option
from llfsm.cli.ros_options import BridgeOptions, RosCommand, bridge_options


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


@click.command()
@click.argument("file", type=click.Path(path_type=Path))
@board_option
def check(file: Path, board: BoardPlace) -> None:
    """Check a bridge's configuration FILE without running it; print every fault.

    It checks types, names, duplicates and loops and, if the whiteboard exists, that its slots have
    the types that FILE gives them. It warns of slots that are too small for what their sensors
    send, and notes the sizes that it assumes. The exit status is 2 for an error, else 0.
    """
    _, findings = Configured.read(file).examine(slots_on(board))
    for line in (*findings.faults, *findings.warnings, *findings.notes):
        click.echo(line)
    if findings.faults:
        sys.exit(2)
    if not findings.warnings:
        click.echo("no findings")
