"""The options and arguments that several commands share, and what ``--until-eof`` does."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from llfsm.whiteboard.board_files import default_name

__all__ = [
    "board_option",
    "directory_option",
    "end_with_input",
    "output_option",
    "recording_argument",
    "slots_option",
    "supervised_options",
    "until_eof_option",
]

board_option = click.option(
    "-b",
    "--board",
    metavar="NAME",
    default=default_name,
    help="The whiteboard; by default $WHITEBOARD_NAME, else `whiteboard`.",
)

directory_option = click.option(
    "--directory",
    metavar="DIR",
    type=click.Path(file_okay=False),
    default="/dev/shm",
    help="The folder of the whiteboard's file; by default /dev/shm.",
)

recording_argument = click.argument("file", type=click.Path(path_type=Path))

slots_option = click.option(
    "--slots",
    metavar="GLOB",
    multiple=True,
    help="Only slots whose names match, as 'turtle1/*'. May be repeated.",
)

until_eof_option = click.option(
    "--until-eof", is_flag=True, help="End when standard input is closed, as by a supervisor."
)


def supervised_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options of a command that uses a whiteboard and may run under a supervisor."""
    return click.option(
        "--remove-board", is_flag=True, help="Remove the whiteboard at the end, on errors too."
    )(until_eof_option(command))


def output_option(what: str) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Return the option for the folder in which to make `what`."""
    return click.option(
        "-o",
        "--output",
        metavar="DIR",
        type=click.Path(file_okay=False, path_type=Path),
        default=".",
        help=f"Make {what} in this folder; by default the current one.",
    )


def end_with_input() -> None:
    """Send this process SIGTERM when its standard input is closed.

    A supervisor that holds the other end of the pipe thus ends its processes even if it is killed.
    """

    def wait() -> None:
        while os.read(0, 4096):
            pass
        os.kill(os.getpid(), signal.SIGTERM)

    threading.Thread(target=wait, name="until-eof", daemon=True).start()
