"""``llfsm turtlesim``: the simulator as a process on a whiteboard."""

from __future__ import annotations

import importlib.util
import logging
import signal
import sys
from pathlib import Path
from types import FrameType

import click

from llfsm.runtime.commands.options import board_option
from llfsm.runtime.commands.supervised import end_with_input, supervised_options
from llfsm.whiteboard import Whiteboard

from .errors import TurtlesimError
from .field import draw
from .node import TurtlesimNode, run
from .simulator import Simulator

__all__ = ["turtlesim"]


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


_Spawn = tuple[str, float, float, float]


@click.command()
@click.option(
    "--turtle",
    "turtles",
    metavar="NAME,X,Y,THETA",
    multiple=True,
    callback=_parse_turtle,
    help="One more turtle, besides turtle1 in the centre: metres from the lower left, radians.",
)
@click.option(
    "--picture",
    type=click.Path(path_type=Path),
    help="Draw the field at the end: FILE.svg, FILE.png, or both if FILE has no ending.",
)
@board_option
@supervised_options
def turtlesim(
    turtles: list[_Spawn],
    picture: Path | None,
    board: str,
    until_eof: bool,
    remove_board: bool,
) -> None:
    """Simulate turtles that obey a whiteboard, until Ctrl-C or the whiteboard is removed.

    For each turtle it pulls <turtle>/cmd_vel, posts <turtle>/pose and <turtle>/color_sensor
    62.5 times a second, and answers requests on turtle_position/request.

    \b
    llfsm turtlesim --turtle bob,2,2,0
    llfsm whiteboard add turtle1/cmd_vel '{"linear": {"x": 2}}'
    """
    logging.basicConfig(level=logging.INFO, format="%(message)s", stream=sys.stderr)
    over = False

    def end(_: int, __: FrameType | None) -> None:
        nonlocal over
        over = True

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, end)
    try:
        simulator = Simulator(log=logging.getLogger("turtlesim").log)
        for name, x, y, theta in turtles:
            if not simulator.spawn(x, y, theta, name):
                raise click.UsageError(f"--turtle {name}: see the line above")
        with Whiteboard(board) as wb:
            if until_eof:
                end_with_input()
            try:
                run(TurtlesimNode(simulator, wb), lambda: over or not wb.alive)
            finally:
                if remove_board:
                    wb.remove()
        if picture is not None:
            if not picture.suffix and importlib.util.find_spec("PIL") is None:
                picture = picture.with_suffix(".svg")  # what this installation can draw
            for path in draw(simulator, picture):
                click.echo(f"drawn: {path}", err=True)
    except TurtlesimError as error:
        raise click.ClickException(str(error)) from error
