"""``llfsm bridge check``: the faults of a bridge's configuration."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from ..options import BoardPlace, board_option
from .configured import Configured, slots_on

__all__ = ["check"]


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
