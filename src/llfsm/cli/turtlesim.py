"""``llfsm turtlesim``: the simulator as a process, on a whiteboard or as a ROS 2 node."""

from __future__ import annotations

import importlib.util
import logging
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from types import FrameType

import click
from click.core import ParameterSource

from llfsm.bridges.ros2.transport import Transport
from llfsm.bridges.turtlesim.field import draw
from llfsm.bridges.turtlesim.node import TurtlesimNode
from llfsm.bridges.turtlesim.simulator import Simulator, run
from llfsm.whiteboard import Whiteboard

from .options import board_option, end_with_input, supervised_options
from .ros_options import open_chosen, ros_options

__all__ = ["turtlesim"]

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


@click.command()
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
@click.option(
    "--ros",
    is_flag=True,
    help="Run as the ROS 2 node turtlesim, without a whiteboard.",
)
@ros_options(" (with --ros)")
@board_option
@supervised_options
@click.pass_context
def turtlesim(
    context: click.Context,
    turtles: list[_Spawn],
    picture: Path | None,
    ros: bool,
    transport: str,
    domain: int | None,
    router: tuple[str, ...],
    board: str,
    until_eof: bool,
    remove_board: bool,
) -> None:
    """Simulate turtles that obey a whiteboard, until Ctrl-C or the whiteboard is removed.

    For each turtle it reads <turtle>/cmd_vel and posts <turtle>/pose and <turtle>/color_sensor
    62.5 times a second; it answers requests on turtle_position/request. With --ros it runs as the
    node turtlesim instead, with all of its topics, services, parameters and its action.

    \b
    llfsm turtlesim --turtle bob,2,2,0
    llfsm whiteboard add turtle1/cmd_vel '{"linear": {"x": 2}}'
    llfsm turtlesim --ros --transport zenoh
    """
    _check_options(context, "ros" if ros else "board")
    logging.basicConfig(level=logging.INFO, format="%(message)s", stream=sys.stderr)
    over = False

    def end(_: int, __: FrameType | None) -> None:
        nonlocal over
        over = True

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, end)
    if until_eof:
        end_with_input()
    if ros:
        with open_chosen(transport, domain, router) as opened:
            simulator = _run_on_ros(opened, turtles, lambda: over)
    else:
        simulator = _run_on_board(board, turtles, lambda: over, remove_board)
    if picture is not None:
        if not picture.suffix and importlib.util.find_spec("PIL") is None:
            picture = picture.with_suffix(".svg")  # what this installation can draw
        for path in draw(simulator, picture):
            click.echo(f"drawn: {path}", err=True)


def _check_options(context: click.Context, world: str) -> None:
    """Refuse the options that apply to the other of the two worlds only."""
    other = {"ros": ("board", "remove_board"), "board": ("transport", "domain", "router")}[world]
    flags = {param.name: param.opts[-1] for param in context.command.params}
    for name in other:
        if context.get_parameter_source(name) is ParameterSource.COMMANDLINE:
            hint = "touches no whiteboard: leave out" if world == "ros" else "is needed for"
            raise click.UsageError(f"--ros {hint} {flags[name]}")


def _run_on_board(
    name: str, turtles: list[_Spawn], is_over: Callable[[], bool], remove: bool
) -> Simulator:
    simulator = Simulator(log=_LOG)
    _spawn(turtles, simulator.spawn)
    with Whiteboard(name) as board:
        try:
            run(TurtlesimNode(simulator, board).step, lambda: is_over() or not board.alive)
        finally:
            if remove:
                board.remove()
    return simulator


def _run_on_ros(
    transport: Transport, turtles: list[_Spawn], is_over: Callable[[], bool]
) -> Simulator:
    from llfsm.bridges.turtlesim.ros import RosTurtlesim

    node = RosTurtlesim(transport, log=_LOG)
    _spawn(turtles, node.spawn)
    run(node.step, lambda: is_over() or transport.closed)
    return node.simulator


def _spawn(turtles: list[_Spawn], spawn: Callable[[float, float, float, str], str]) -> None:
    for name, x, y, theta in turtles:
        if not spawn(x, y, theta, name):
            raise click.UsageError(f"--turtle {name}: see the line above")
