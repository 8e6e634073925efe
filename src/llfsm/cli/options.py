"""Options that several commands share."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from llfsm.whiteboard.shared import default_name

__all__ = ["board_option", "directory_option", "output_option"]

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
    help="Where the whiteboard's file is; by default /dev/shm.",
)


def output_option(what: str) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Return the option that says in which folder to make `what`."""
    return click.option(
        "-o",
        "--output",
        metavar="DIR",
        type=click.Path(file_okay=False, path_type=Path),
        default=".",
        help=f"Make {what} in this folder; by default the current one.",
    )
