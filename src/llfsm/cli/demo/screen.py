"""A running demo on the terminal."""

from __future__ import annotations

import sys
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Protocol, Self

import click

from ..board_tables import Watcher, machine_table, slot_table, turtle_field
from ..options import BoardPlace
from .processes import ProcessStatus

if TYPE_CHECKING:
    from rich.console import RenderableType

__all__ = ["LiveBoard", "Parts", "show"]

_FRAME_S = 0.1
_NEWS = 5  # lines of it on the terminal


class Parts(Protocol):
    """The parts of a running demo: processes, or threads of this one."""

    reports: deque[str]

    def statuses(self) -> list[ProcessStatus]:
        """Return the status of each part."""
        ...

    def wait(self, seconds: float) -> None:
        """Wait while the parts work."""
        ...


class LiveBoard:
    """The whiteboard of a demo, removed at the end.

    A process of the demo that ends removes it as well; then it is created again.
    """

    def __init__(self, place: BoardPlace) -> None:
        self._place = place
        self._open()

    def _open(self) -> None:
        self._board = self._place.open()
        self._watcher = Watcher(self._board)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._board.remove()
        self._board.close()

    def watcher(self) -> Watcher:
        """Return the watcher of the whiteboard, which is created again if it was removed."""
        if not self._board.alive:
            self._board.close()
            self._open()
        return self._watcher


def show(watcher: Callable[[], Watcher], parts: Parts, title: str, seconds: float | None) -> None:
    """Show a demo for `seconds`: as a screen on a terminal, else a line for each change."""
    started = time.monotonic()
    until = float("inf") if seconds is None else started + seconds

    def timed(line: str) -> str:
        return f"{time.monotonic() - started:6.1f} s  {line}"

    if sys.stdout.isatty():
        from rich.live import Live

        news: deque[str] = deque(maxlen=_NEWS)
        with Live(auto_refresh=False) as live:
            while time.monotonic() < until:
                news.extend(map(timed, _reports(parts)))
                shown = _picture(watcher(), title, parts.statuses(), news)
                live.update(shown, refresh=True)
                parts.wait(_FRAME_S)
        return
    click.echo(title)
    printed: dict[str, str] = {}
    while time.monotonic() < until:
        for report in _reports(parts):
            click.echo(timed(report))
        watched = watcher()
        pose = watched.pose()
        where = "" if pose is None else f"  turtle1 at ({pose.x:.2f}, {pose.y:.2f})"
        states = {machine.name: machine.state for machine in watched.machines()}
        for machine, state in states.items():
            if printed.get(machine) != state:
                click.echo(timed(f"{machine}: {state}{where}"))
        printed = states
        parts.wait(_FRAME_S / 2)


def _reports(parts: Parts) -> Iterator[str]:
    while parts.reports:
        yield parts.reports.popleft()


def _picture(
    watcher: Watcher, title: str, processes: Sequence[ProcessStatus], news: Sequence[str]
) -> RenderableType:
    """Return the screen of a terminal: machines, turtle, processes, slots and the latest news."""
    from rich.columns import Columns
    from rich.console import Group
    from rich.panel import Panel
    from rich.table import Table
    from rich.text import Text

    machines = machine_table(watcher.machines())
    running = Table.grid(padding=(0, 2))
    for name, pid, since_s, output in processes:
        state = Text("starts again", "bold red") if pid is None else Text(f"process {pid}", "green")
        running.add_row(name, state, f"{since_s:5.0f} s", Text(output, "dim", no_wrap=True))
    pose = watcher.pose()
    board = slot_table(watcher.slots())
    top: list[RenderableType] = [Panel(machines, title="machines", title_align="left")]
    if pose is not None:
        where = f"turtle1 at ({pose.x:.2f}, {pose.y:.2f})"
        top.append(Panel(turtle_field(watcher, pose), title=where, title_align="left"))
    return Group(
        Text(title, "bold"),
        Columns(top),
        Panel(running, title="processes", title_align="left"),
        Panel(board, title="whiteboard", title_align="left"),
        *(Text(line, "red") for line in news),
    )
