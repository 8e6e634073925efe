"""``llfsm bridge ros2``, ``turtlesim`` and ``check``: run or check a bridge to ROS 2.

While it runs, the counts of its links are shown: on a terminal as a table, else as lines.
"""

from __future__ import annotations

import logging
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import click

from llfsm.bridges.ros2.bridging.bridge import Bridge
from llfsm.bridges.ros2.bridging.bridge_config import Direction, RelayConfig, turtlesim_config
from llfsm.bridges.ros2.bridging.link import BridgeLink
from llfsm.bridges.ros2.errors import DomainIdError, RosArgumentError
from llfsm.bridges.ros2.ros_arguments import RosArguments
from llfsm.cli.bridge.configured import BadConfigurationError, Configured, slots_on
from llfsm.cli.console import ending_once, log_to_console, stop_for_good
from llfsm.cli.echo import echo
from llfsm.cli.options import (
    BoardPlace,
    BoardRemovedError,
    board_option,
    end_with_input,
    file_option,
)
from llfsm.cli.ros_options import BridgeOptions, RosCommand, bridge_options, ros_arguments
from llfsm.errors import printable
from llfsm.runtime.engine.realtime import StopRequest, stop_on_signals
from llfsm.runtime.presence.guard import GuardThread
from llfsm.whiteboard import SlotTypeError, Whiteboard

if TYPE_CHECKING:
    from rich.table import Table


@click.command(cls=RosCommand)
@file_option("--config", "file", help="What to connect, as TOML; see docs/how-to/ros2.md.")
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
        echo(line)
    if findings.faults:
        sys.exit(2)
    if not findings.warnings:
        echo("no findings")


_FRAME_S = 0.25
_LINES_S = 10.0
_RATE_S = 1.0  # the shortest time over which a rate is measured


class Count(NamedTuple):
    """A link and its rate."""

    link: BridgeLink
    rate: float  # messages a second, lately

    def __str__(self) -> str:
        link, age = self.link, self.link.age
        ago = "" if age is None else f", the last {age:.1f} s ago"
        failed = f", {link.failed} failed" if link.failed else ""
        return f"{link}: {link.passed}, {self.rate:.1f}/s{ago}{failed}"


class Counts:
    """Counts of links; rates are those since the last `read` a second or more ago."""

    def __init__(
        self, links: Sequence[BridgeLink], now: Callable[[], float] = time.monotonic
    ) -> None:
        self._links = links
        self._now = now
        self._then = now()
        self._passed = [0] * len(links)
        self._rates = [0.0] * len(links)

    def read(self) -> list[Count]:
        """Read the current count of each link."""
        now = self._now()
        seconds = now - self._then
        if seconds >= _RATE_S:
            passed = [link.passed for link in self._links]
            self._rates = [
                (new - old) / seconds for new, old in zip(passed, self._passed, strict=True)
            ]
            self._then, self._passed = now, passed
        return [Count(*pair) for pair in zip(self._links, self._rates, strict=True)]


def show_until(over: Callable[[float], bool], links: Sequence[BridgeLink]) -> None:
    """Show counts on standard output until ``over(seconds)``, which waits that long, is true."""
    counts = Counts(links)
    if not sys.stdout.isatty():
        while not over(_LINES_S):
            _print(counts)
        _print(counts)
        return
    from rich.live import Live

    with Live(_table(counts), auto_refresh=False) as live:
        for handler in logging.getLogger().handlers:
            if isinstance(handler, logging.StreamHandler):
                handler.setStream(sys.stderr)  # which Live has redirected above the table
        while not over(_FRAME_S):
            live.update(_table(counts), refresh=True)


def _print(counts: Counts) -> None:
    for count in counts.read():
        echo(str(count))


def _table(counts: Counts) -> Table:
    from rich.table import Table

    table = Table(box=None, pad_edge=False)
    for title in ("slot", "", "ROS", "type"):
        table.add_column(title, overflow="fold")
    for title in ("passed", "per s", "age", "failed"):
        table.add_column(title, justify="right", no_wrap=True)
    for link, rate in counts.read():
        age = "" if link.age is None else f"{link.age:.1f} s"
        failed = str(link.failed) if link.failed else ""
        numbers = (str(link.passed), f"{rate:.1f}", age, failed)
        table.add_row(*map(printable, (link.slot, link.arrow, link.name, link.type_name)), *numbers)
    return table


_POLL_S = 0.25  # between two looks whether the whiteboard still exists
_MEET_S = 1.0  # for the robot's nodes to find the bridge's: a safe value must not be too early


def run_bridge(configured: Configured, options: BridgeOptions) -> None:
    """Run a bridge until SIGINT, SIGTERM or the removal of its whiteboard.

    After the first signal it still relays for a while, for machines that post a stop at their end.
    Once it relays, a second signal changes nothing.
    """
    arguments = ros_arguments()
    log_to_console(logging.INFO, is_on=arguments.stdout)
    try:
        asked, named = StopRequest(), configured.named(options.node)
        ending_once(lambda: _run(named, options, arguments, asked), asked.is_made)
    except (DomainIdError, RosArgumentError, SlotTypeError) as error:
        raise BadConfigurationError(str(error)) from error


def _run(
    configured: Configured, options: BridgeOptions, arguments: RosArguments, asked: StopRequest
) -> None:
    with stop_on_signals(lambda _: asked.make()), ExitStack() as stack:
        plan = configured.plan(slots_on(options.board), arguments)
        logging.getLogger().setLevel(arguments.log_level(plan.node.full_node))
        transport = stack.enter_context(options.graph.open(arguments.enclave))
        board = stack.enter_context(options.board.open())
        if options.remove_board:
            stack.callback(board.remove)
        bridge = Bridge(plan, board, transport)
        stack.callback(bridge.close)
        if arguments.rosout:
            logging.getLogger().addHandler(bridge.log)
            stack.callback(logging.getLogger().removeHandler, bridge.log)
        stack.enter_context(GuardThread(*options.board, after_s=_MEET_S))
        end_with_input()
        stop_for_good(asked.make)
        where = f"ROS domain {transport.domain}, whiteboard {board.name}"
        echo(f"bridge: {plan.node.full_node} in {where}", err=True)
        _stay(bridge, board, asked, options.quiet)
        bridge.linger()
        if not board.alive and not asked.is_made():
            raise BoardRemovedError(board.name)


def _stay(bridge: Bridge, board: Whiteboard, asked: StopRequest, quiet: bool) -> None:
    def over(seconds: float) -> bool:
        until = time.monotonic() + seconds
        while board.alive and not asked.is_made() and time.monotonic() < until:
            asked.wait(min(seconds, _POLL_S))
        return asked.is_made() or not board.alive

    if quiet:
        while not over(_POLL_S):
            pass
    else:
        show_until(over, bridge.links)
