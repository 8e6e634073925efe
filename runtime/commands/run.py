"""``llfsm run``: machines as one arrangement, with clfsm's letters."""

from __future__ import annotations

import importlib.metadata
import logging
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Literal

import click

from llfsm.whiteboard import Whiteboard

from ..arrangement import Arrangement
from ..bundles import SUFFIX
from ..machine import Machine
from ..status import StatusPoster
from .board import board_option
from .machines import find_machine, parse_assignments
from .report import StateReport, SuspensionReport
from .supervised import end_with_input, supervised_options

__all__ = ["run"]


@click.command()
@click.argument("machines", nargs=-1)
@click.option(
    "-S", "suspended", metavar="MACHINE", multiple=True, help="Load MACHINE, too, suspended."
)
@click.option(
    "-v",
    "verbose",
    count=True,
    help="Tell each state change: machine number, state number, machine, state; -vv: its path too.",
)
@click.option("-s", "report", is_flag=True, help="Tell of suspends, resumes and restarts.")
@click.option("-q", "quiet", is_flag=True, help="Leave out the header.")
@click.option("-u", "keep", is_flag=True, help="Do not unload accepting machines.")
@click.option(
    "-i",
    "idle_us",
    metavar="US",
    type=click.IntRange(0),
    default=10_000,
    show_default=True,
    help="Sleep so many microseconds after a round in which no transition fired.",
)
@click.option(
    "--on-error",
    type=click.Choice(["stop", "suspend"]),
    default="stop",
    show_default=True,
    help="When a machine's code raises: stop all, or suspend that machine.",
)
@board_option
@supervised_options
def run(
    machines: tuple[str, ...],
    suspended: tuple[str, ...],
    verbose: int,
    report: bool,
    quiet: bool,
    keep: bool,
    idle_us: int,
    on_error: Literal["stop", "suspend"],
    board: str,
    until_eof: bool,
    remove_board: bool,
) -> None:
    """Run MACHINES, in this order, until all accept or are suspended, or Ctrl-C.

    A machine is one that ships, package.module:Class, or the folder of a bundle;
    name:variable=value sets a variable.

    \b
    llfsm run RosPingPong -v
    llfsm run path/to/Patrol.machine
    llfsm run RosBlindTurttleBot TurtleSuspendResume -s
    llfsm run my_robot.patrol:Patrol Patrol:rounds=3
    """
    chosen = [find_machine(text) for text in machines if "=" not in text]
    waiting = [find_machine(text) for text in suspended]
    if not chosen and not waiting:
        raise click.UsageError("name a machine to run; `llfsm run --help` shows examples")
    named: dict[str, type[Machine]] = {}
    for cls in (*chosen, *waiting):
        named[_free_name(cls.__name__, named)] = cls
    variables = parse_assignments([text for text in machines if "=" in text], named)
    logging.basicConfig(level=logging.INFO, format="%(message)s", stream=sys.stdout)
    with Whiteboard(board) as wb:
        try:
            arrangement = Arrangement(
                whiteboard=wb,
                idle_us=idle_us,
                unload_accepting=not keep,
                library=_Library(named.values()),
                on_error=on_error,
            )
            for number, (name, cls) in enumerate(named.items()):
                load = arrangement.load if number < len(chosen) else arrangement.load_suspended
                load(cls, variables=variables[name])
            arrangement.after_rounds.append(poster := StatusPoster(arrangement, wb))
            if verbose:
                arrangement.attach(StateReport(arrangement, with_path=verbose > 1))
            if report:
                arrangement.attach(SuspensionReport(arrangement))
            if not quiet:
                version = importlib.metadata.version("llfsm")
                click.echo(f"llfsm {version}: {', '.join(named)} on whiteboard {wb.name}", err=True)
            if until_eof:
                end_with_input()
            try:
                arrangement.run()
            finally:
                poster.end()
        finally:
            if remove_board:
                wb.remove()


def _free_name(name: str, taken: dict[str, type[Machine]]) -> str:
    """Return the name that the arrangement will give the next machine of this name."""
    names = [name, *(f"{name}.{number}" for number in range(len(taken)))]
    return next(free for free in names if free not in taken)


class _Library:
    """Find machines that code loads by name: also bundles beside those that it was started with."""

    def __init__(self, machines: Iterable[type[Machine]]):
        paths = [Path(cls.table.path) for cls in machines]
        self._folders = list(dict.fromkeys(path.parent for path in paths if path.suffix == SUFFIX))

    def __call__(self, name: str) -> type[Machine] | None:
        try:
            return find_machine(name, self._folders)
        except click.UsageError:
            return None  # the arrangement's own error names those that can be loaded
