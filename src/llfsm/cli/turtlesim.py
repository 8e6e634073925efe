"""``llfsm turtlesim``: simulate turtles in this process, on a whiteboard or as a ROS 2 node."""

from __future__ import annotations

import importlib.util
import logging
from collections.abc import Callable
from pathlib import Path

import click

from llfsm.bridges.ros2.errors import RosArgumentError
from llfsm.bridges.ros2.graph import logger_name
from llfsm.bridges.ros2.ros_arguments import RosArguments
from llfsm.bridges.ros2.standard_node import ConsoleFormat
from llfsm.bridges.ros2.transport import Transport
from llfsm.bridges.turtlesim.field import draw
from llfsm.bridges.turtlesim.node import TurtlesimNode
from llfsm.bridges.turtlesim.simulator import Simulator, run
from llfsm.cli.console import ignore_interrupts, log_to_console, stop_for_good
from llfsm.cli.echo import echo
from llfsm.cli.options import (
    BoardPlace,
    BoardRemovedError,
    board_option,
    end_with_input,
    given_option,
    supervised_options,
)
from llfsm.cli.ros_options import GraphOptions, RosCommand, require_ros, ros_arguments, ros_options
from llfsm.runtime.engine.realtime import StopRequest

_LOG = logging.getLogger("turtlesim").log

_Spawn = tuple[str, float, float, float]  # name, x, y, theta


def _parse_turtle(_: click.Context, __: click.Parameter, texts: tuple[str, ...]) -> list[_Spawn]:
    spawns = []
    for text in texts:
        name, *place = text.split(",")
        try:
            x, y, theta = map(float, place)
        except ValueError:
            raise click.BadParameter(f"{text!r} is not NAME,X,Y,THETA") from None
        spawns.append((name, x, y, theta))
    return spawns


@click.command(cls=RosCommand)
@click.option(
    "--turtle",
    "turtles",
    metavar="NAME,X,Y,THETA",
    multiple=True,
    callback=_parse_turtle,
    help="Another turtle beside turtle1 in the centre; metres from the lower left, radians.",
)
@click.option(
    "--picture",
    type=click.Path(path_type=Path),
    help="Draw the field at the end: FILE.svg, FILE.png, or both if FILE has no suffix.",
)
@click.option("--ros", is_flag=True, help="Run as the ROS 2 node turtlesim, without a whiteboard.")
@click.option("--clock", is_flag=True, help="Publish the simulated time on /clock (with --ros).")
@ros_options(" (with --ros)")
@board_option
@supervised_options
def turtlesim(
    turtles: list[_Spawn],
    picture: Path | None,
    ros: bool,
    clock: bool,
    graph: GraphOptions,
    board: BoardPlace,
    remove_board: bool,
) -> None:
    """Simulate turtles that obey a whiteboard, until Ctrl-C or the whiteboard is removed.

    For each turtle it reads <turtle>/cmd_vel and posts <turtle>/pose and <turtle>/color_sensor
    62.5 times a second; it answers requests on turtle_position/request. With --ros it runs as the
    node turtlesim instead, with all of its topics, services, parameters and its action, and takes
    the arguments of ROS after --ros-args.

    \b
    llfsm turtlesim --turtle bob,2,2,0
    llfsm whiteboard add turtle1/cmd_vel '{"linear": {"x": 2}}'
    llfsm turtlesim --ros --transport zenoh
    """
    require_ros("clock", "transport", "domain", "router", ros=ros)
    if ros and (given := given_option("board", "directory", "remove_board")):
        raise click.UsageError(f"--ros touches no whiteboard: leave out {given}")
    arguments = ros_arguments()
    log_to_console(logging.INFO, is_on=arguments.stdout)
    asked = StopRequest()
    stop_for_good(asked.make)
    end_with_input()
    if ros:
        with graph.open(arguments.enclave) as opened:
            simulator = _run_on_ros(opened, turtles, asked.is_made, arguments, clock)
    else:
        simulator = _run_on_board(board, turtles, asked.is_made, remove_board)
    ignore_interrupts()
    if picture is not None:
        for path in draw_field(simulator, picture):
            echo(f"drawn: {path}", err=True)


def draw_field(simulator: Simulator, picture: Path) -> tuple[Path, ...]:
    """Draw the field to `picture`, or without a suffix to each format at hand; return the files."""
    if not picture.suffix and importlib.util.find_spec("PIL") is None:
        picture = picture.with_suffix(".svg")
    return draw(simulator, picture)


def _run_on_board(
    place: BoardPlace, turtles: list[_Spawn], is_over: Callable[[], bool], remove: bool
) -> Simulator:
    simulator = Simulator(log=_LOG)
    _spawn(turtles, simulator.spawn)
    with place.open() as board:
        try:
            run(TurtlesimNode(simulator, board).step, lambda: is_over() or not board.alive)
            if not board.alive and not is_over():
                raise BoardRemovedError(board.name)
        finally:
            if remove:
                board.remove()
    return simulator


def _run_on_ros(
    transport: Transport,
    turtles: list[_Spawn],
    is_over: Callable[[], bool],
    arguments: RosArguments,
    clock: bool,
) -> Simulator:
    from llfsm.bridges.turtlesim.ros import RosTurtlesim

    names = arguments.names("turtlesim")
    logging.getLogger().setLevel(arguments.log_level(names.full_node))
    for handler in logging.getLogger().handlers:
        handler.setFormatter(ConsoleFormat(logger_name(names.full_node)))
    try:
        node = RosTurtlesim(transport, _LOG, arguments, clock=clock)
    except RosArgumentError as error:
        raise click.UsageError(str(error)) from error
    _spawn(turtles, node.spawn)
    run(node.step, lambda: is_over() or transport.closed)
    return node.simulator


def _spawn(turtles: list[_Spawn], spawn: Callable[[float, float, float, str], str]) -> None:
    for name, x, y, theta in turtles:
        if not spawn(x, y, theta, name):
            raise click.UsageError(f"--turtle {name}: see the line above")
