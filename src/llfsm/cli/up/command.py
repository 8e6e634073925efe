"""`llfsm up`: start the processes of a system, show what they print, and end them as one."""

from __future__ import annotations

import signal
import sys
from contextlib import ExitStack
from datetime import datetime
from itertools import cycle
from pathlib import Path
from types import FrameType
from typing import Final, TextIO

import click

from llfsm.cli.echo import echo, echo_from
from llfsm.cli.up.processes import Processes
from llfsm.cli.up.system import ProcessPlan, read_systems

_COLOURS: Final = ("cyan", "yellow", "green", "magenta", "blue", "bright_red")


@click.command()
@click.argument(
    "files", metavar="FILE...", nargs=-1, required=True, type=click.Path(path_type=Path)
)
@click.option(
    "--log-dir",
    metavar="DIR",
    type=click.Path(file_okay=False, path_type=Path),
    help="Also write what each process prints to DIR/NAME.log, with the time.",
)
def up(files: tuple[Path, ...], log_dir: Path | None) -> None:
    """Start the processes of a system, and end them as one.

    A FILE has a table [[process]] for each: machines, bridges, daemons, recorders or any program.
    Ctrl-C ends all, those last that others wait for; a second one kills them. The exit status is
    1 if a process has failed.

    \b
    llfsm up robot.toml
    llfsm up robot.toml cameras.toml --log-dir logs
    """
    if sys.platform == "win32":
        raise click.ClickException("llfsm up runs on Linux and macOS: start each process by itself")
    plans = read_systems(files)
    with ExitStack() as stack:
        output = _Output(plans, stack, log_dir)
        processes = Processes(plans, show=output.show, report=output.report)
        signals = _signals()
        try:
            while not (processes.over or signals):
                processes.look()
            if signals:
                output.report("all end; a second Ctrl-C kills them")
        finally:
            processes.end(lambda: len(signals) > 1)
    if processes.failed:
        raise click.exceptions.Exit(1)


def _signals() -> list[int]:
    """Collect the signals that ask for the end in a list, from now until this process ends."""
    came: list[int] = []

    def note(number: int, _: FrameType | None) -> None:
        came.append(number)

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, note)
    return came


class _Output:
    """What processes print, each line after its process's name, and what becomes of them."""

    def __init__(self, plans: list[ProcessPlan], stack: ExitStack, folder: Path | None):
        names = [plan.planned.name for plan in plans]
        self._width = max(map(len, names))
        self._colours = dict(zip(names, cycle(_COLOURS), strict=False))
        self._files: dict[str, TextIO] = {}
        if folder is not None:
            folder.mkdir(parents=True, exist_ok=True)
            for name in names:
                file = (folder / f"{name}.log").open("a", encoding="utf-8", buffering=1)
                self._files[name] = stack.enter_context(file)

    def show(self, name: str, line: str) -> None:
        """Show a line that a process has printed."""
        echo_from(f"{name:{self._width}} |", line, self._colours[name])
        if name in self._files:
            self._files[name].write(f"{datetime.now().isoformat(timespec='milliseconds')} {line}\n")

    def report(self, text: str) -> None:
        """Report what becomes of a process."""
        echo(text, err=True)
