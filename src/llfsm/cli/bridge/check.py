"""``llfsm bridge check``: the faults of a bridge's configuration."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from ..options import board_option
from .configured import Configured, slots_on

__all__ = ["check"]


@click.command()
@click.argument("file", type=click.Path(path_type=Path))
@board_option
def check(file: Path, board: str) -> None:
    """Check a bridge's configuration FILE without running it; print every fault.

    It checks types, names, duplicates and loops and, if the whiteboard exists, that its slots have
    the types that FILE gives them. The exit status is 2 if anything is wrong, else 0.
    """
    _, faults = Configured.read(file).examine(slots_on(board))
    for fault in faults:
        click.echo(fault)
    if faults:
        sys.exit(2)
    click.echo("no findings")
