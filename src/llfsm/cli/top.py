"""``llfsm top``: a whiteboard and its machines on the terminal, refreshed until Ctrl-C."""

from __future__ import annotations

import sys
import time
from typing import TYPE_CHECKING

import click

from llfsm.runtime.engine.signals import stop_on_signals

from .board_tables import Watcher, machine_table, slot_table
from .options import BoardPlace, board_option, fleet_option, host_option
from .ps import shown_of

if TYPE_CHECKING:
    from rich.console import RenderableType

__all__ = ["top"]

_FRAME_S = 0.25  # as often as a table can be read
_COUNTING_S = 1.0  # the time until rates are known
_WIDTH = 10_000  # columns without a terminal: nothing is cut off


@click.command()
@board_option
@fleet_option
@host_option
@click.option("--once", is_flag=True, help="Print everything once, after a second, and exit.")
def top(board: BoardPlace, fleet: bool, host: str, once: bool) -> None:
    """Show a whiteboard's slots and machines, refreshed four times a second, until Ctrl-C.

    For each machine it shows what `llfsm ps` lists; for each slot the number of messages, their
    rate, and the last one with its age and writer. Slots and machines of other hosts are shown if
    they are mirrored here; --fleet and --host request them.

    \b
    llfsm top -b demo
    llfsm top --once > board.txt
    llfsm top --host robot7
    """
    from rich.console import Console
    from rich.live import Live

    signals: list[str] = []  # that asked this process to end
    with board.open(create=False) as wb, stop_on_signals(signals.append):
        watcher = Watcher(wb, shown_of(wb, host, fleet=fleet))
        if once or not sys.stdout.isatty():
            watcher.slots()
            time.sleep(_COUNTING_S)  # a rate needs two looks, this far apart
            if sys.stdout.isatty():
                Console(highlight=False).print(_screen(watcher, board.name))
            else:
                _print(_screen(watcher, board.name))
            return
        with Live(auto_refresh=False, screen=True, vertical_overflow="crop") as live:
            while wb.alive and not signals:
                live.update(_screen(watcher, board.name), refresh=True)
                time.sleep(_FRAME_S)
    if not signals:
        raise click.ClickException(f"the whiteboard {board.name!r} was removed")


def _print(screen: RenderableType) -> None:
    """Print plain lines of any length, without the trailing blanks of a terminal's."""
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
