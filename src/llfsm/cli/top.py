"""``llfsm top``: a whiteboard and its machines on the terminal, refreshed until Ctrl-C."""

from __future__ import annotations

import sys
import time
from typing import TYPE_CHECKING

import click

from llfsm.runtime.engine.signals import stop_on_signals
from llfsm.whiteboard import Whiteboard

from .options import board_option
from .tables import Watcher, machine_table, slot_table

if TYPE_CHECKING:
    from rich.console import RenderableType

__all__ = ["top"]

_FRAME_S = 0.25  # as often as a table can be read
_COUNTING_S = 1.0  # until there is a rate
_WIDTH = 10_000  # columns where there is no terminal: nothing is cut off


@click.command()
@board_option
@click.option("--once", is_flag=True, help="Print everything once, after a second, and end.")
def top(board: str, once: bool) -> None:
    """Show a whiteboard's slots and machines, refreshed four times a second, until Ctrl-C.

    Of each machine: state, since when, and as `llfsm ps`; of each slot: how many messages were
    added, how many a second, when and by which process the last one, and what it is.

    \b
    llfsm top -b demo
    llfsm top --once > board.txt
    """
    from rich.console import Console
    from rich.live import Live

    asked: list[str] = []  # the signal by which an end is
    with Whiteboard(board, create=False) as wb, stop_on_signals(asked.append):
        watcher = Watcher(wb)
        if once or not sys.stdout.isatty():
            watcher.slots()
            time.sleep(_COUNTING_S)
            if sys.stdout.isatty():
                Console(highlight=False).print(_screen(watcher, board))
            else:
                _print(_screen(watcher, board))
            return
        with Live(auto_refresh=False, screen=True, vertical_overflow="crop") as live:
            while wb.alive and not asked:
                live.update(_screen(watcher, board), refresh=True)
                time.sleep(_FRAME_S)
    if not asked:
        raise click.ClickException(f"the whiteboard {board!r} was removed")


def _print(screen: RenderableType) -> None:
    """Print plain lines, of whatever length, without the blanks that fill a terminal's."""
    from rich.console import Console

    console = Console(width=_WIDTH, highlight=False)
    with console.capture() as captured:
        console.print(screen)
    for line in captured.get().splitlines():
        click.echo(line.rstrip())


def _screen(watcher: Watcher, board: str) -> RenderableType:
    from rich.console import Group
    from rich.text import Text

    machines, slots = watcher.machines(), watcher.slots()
    title = f"whiteboard {board}, machines: {len(machines)}, slots: {len(slots)}"
    parts: list[RenderableType] = [Text(title, "bold")]
    if machines:
        parts += ["", machine_table(machines, wide=True)]
    if slots:
        parts += ["", slot_table(slots, wide=True)]
    return Group(*parts)
