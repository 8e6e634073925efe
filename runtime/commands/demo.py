"""``llfsm demo``: processes that meet on a whiteboard, started and shown together."""

from __future__ import annotations

import signal
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType
from typing import NamedTuple

import click

from llfsm.whiteboard import BoardError, BoardNotFoundError, Whiteboard
from llfsm.whiteboard.messages.llfsm import MachineStatus
from llfsm.whiteboard.shared import boards, remove_board

from .live import Watcher, picture
from .processes import Processes

__all__ = ["demo"]

_FRAME_S = 0.1
_PATIENCE_S = 5.0  # for the processes of a killed demo to go


class _Demo(NamedTuple):
    machines: tuple[str, ...]
    with_turtle: bool
    text: str


_DEMOS = {
    "wall": _Demo(("RosWallTurttleBot",), True, "a turtle that keeps away from the walls"),
    "blind": _Demo(("RosBlindTurttleBot",), True, "a turtle that drives triangles"),
    "suspend": _Demo(
        ("RosBlindTurttleBot", "TurtleSuspendResume"), True, "one machine suspends another"
    ),
    "pingpong": _Demo(("RosPingPong",), False, "a machine that posts a text"),
}


class _EndError(Exception):
    """Raised by the signal handler to leave the loop, wherever it is."""


@click.command()
@click.argument("name", type=click.Choice(list(_DEMOS)))
@click.option("--seconds", type=click.FloatRange(0), help="End after so long; else at Ctrl-C.")
@click.option(
    "--picture",
    "target",
    metavar="FILE",
    type=click.Path(path_type=Path),
    help="Where to draw the turtle's path: FILE.svg, FILE.png, or both; default demo-NAME.",
)
@click.option(
    "-b", "--board", metavar="NAME", default="demo", show_default=True, help="The whiteboard."
)
def demo(name: str, seconds: float | None, target: Path | None, board: str) -> None:
    """Watch machines and a turtle simulator, each in a process, meet on a whiteboard.

    \b
    wall      a turtle that keeps away from the walls
    blind     a turtle that drives triangles
    suspend   one machine suspends and resumes another
    pingpong  a machine that posts a text
    """
    chosen = _DEMOS[name]
    target = target or Path(f"demo-{name}")
    _clear(board)
    with _ending_on_signals(), Whiteboard(board) as wb:
        try:
            with Processes() as processes:
                on_board = ("--board", board)
                if chosen.with_turtle:
                    processes.start(
                        "simulator", "turtlesim", *on_board, "--picture", str(target),
                        "--remove-board",
                    )  # fmt: skip
                owner = () if chosen.with_turtle else ("--remove-board",)
                processes.start("machine", "run", *chosen.machines, "-q", *on_board, *owner)
                title = f"llfsm demo {name}: {chosen.text} (whiteboard {board!r})"
                _show(processes, Watcher(wb), title, seconds)
        except _EndError:
            pass
        finally:
            wb.remove()
    if chosen.with_turtle:
        for path in sorted(target.parent.glob(f"{target.name}.*")):
            click.echo(f"the turtle's path: {path}")


def _show(processes: Processes, watcher: Watcher, title: str, seconds: float | None) -> None:
    until = float("inf") if seconds is None else time.monotonic() + seconds
    if sys.stdout.isatty():
        from rich.live import Live

        with Live(auto_refresh=False) as live:
            while time.monotonic() < until:
                live.update(picture(watcher, title), refresh=True)
                processes.wait(_FRAME_S)
        return
    click.echo(title)
    started = time.monotonic()
    shown: dict[str, MachineStatus] = {}
    while time.monotonic() < until:
        pose = watcher.pose()
        where = "" if pose is None else f"  turtle1 at ({pose.x:.2f}, {pose.y:.2f})"
        for machine in watcher.machines():
            if shown.get(machine.name) != machine.told:
                shown[machine.name] = machine.told
                passed = time.monotonic() - started
                click.echo(f"{passed:6.1f} s  {machine.name}: {machine.state}{where}")
        processes.wait(_FRAME_S / 2)


def _clear(board: str) -> None:
    """Remove the board that a killed run left; refuse if somebody uses it."""
    until = time.monotonic() + _PATIENCE_S
    while True:
        there = {info.name: info.used for info in boards()}
        if board not in there:
            return
        if not there[board]:
            click.echo(f"removing the whiteboard {board!r} that an earlier run left", err=True)
            with suppress(BoardNotFoundError):  # its last process did it meanwhile
                remove_board(board)
            return
        if time.monotonic() > until:
            raise BoardError(
                f"the whiteboard {board!r} is in use; end what uses it or choose another --board"
            )
        time.sleep(0.05)


@contextmanager
def _ending_on_signals() -> Iterator[None]:
    """Leave the block by :class:`_EndError` at the first SIGINT or SIGTERM; later ones wait."""

    def end(_: int, __: FrameType | None) -> None:
        for number in before:
            signal.signal(number, signal.SIG_IGN)
        raise _EndError

    before = {number: signal.signal(number, end) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    except _EndError:
        pass
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
