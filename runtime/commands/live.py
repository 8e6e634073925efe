"""A running demo on the terminal, all of it pulled from the whiteboard."""

from __future__ import annotations

import json
import math
import sys
import time
from collections import deque
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any, Self

import click

from llfsm.whiteboard import BoundSlot, Message, Sample, Whiteboard
from llfsm.whiteboard.messages.llfsm import MACHINES, status_slot
from llfsm.whiteboard.messages.turtlesim import Pose
from llfsm.whiteboard.schema import to_plain
from llfsm.whiteboard.slots import Slot

from ..remote import Directory, RemoteMachine
from .processes import Processes, Standing

if TYPE_CHECKING:
    from rich.console import RenderableType

__all__ = ["LiveBoard", "Watcher", "show"]

_FIELD = 11.09  # metres
_COLUMNS, _ROWS = 44, 18
_ARROWS = "→↗↑↖←↙↓↘"
_RATE_S = 1.0  # over which changes are counted
_FRAME_S = 0.1
_NEWS = 5  # lines of it on the terminal


class Watcher:
    """Pull all there is on a board, as often as somebody looks."""

    def __init__(self, board: Whiteboard) -> None:
        self._board = board
        self._directory = Directory(board)
        self._slots: dict[str, BoundSlot[Any]] = {}
        self._counted: dict[str, tuple[float, int]] = {}
        self._rates: dict[str, float] = {}
        self.trail: dict[tuple[int, int], None] = {}

    def machines(self) -> list[RemoteMachine]:
        """Return the machines that run on the board."""
        return self._directory.machines()

    def pose(self) -> Pose | None:
        """Return where turtle1 is, and remember that it was there."""
        self._find_slots()
        slot = self._slots.get("turtle1/pose")
        pose: Pose | None = None if slot is None else slot.get()
        if pose is not None:
            self.trail[_cell(pose)] = None
        return pose

    def slots(self) -> list[tuple[str, Sample[Message], float]]:
        """Return each slot's name, latest sample and changes per second."""
        now, found = time.monotonic(), []
        for name, slot in self._slots.items():
            sample = slot.sample()
            if sample is None:
                continue
            then, count = self._counted.setdefault(name, (now, sample.count))
            if now - then >= _RATE_S:
                self._rates[name] = (sample.count - count) / (now - then)
                self._counted[name] = (now, sample.count)
            found.append((name, sample, self._rates.get(name, 0.0)))
        return found

    def _find_slots(self) -> None:
        for info in self._board.slots():
            if info.name not in self._slots:
                slot: Slot[Any] = (
                    status_slot(info.name.removeprefix(MACHINES))
                    if info.name.startswith(MACHINES)
                    else self._board.find(info.name)
                )
                self._slots[info.name] = self._board[slot]


class LiveBoard:
    """The whiteboard of a demo, removed at the end.

    A process that somebody else ends removes it, too: then it is made again.
    """

    def __init__(self, name: str) -> None:
        self._name = name
        self._open()

    def _open(self) -> None:
        self._board = Whiteboard(self._name)
        self._watcher = Watcher(self._board)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._board.remove()
        self._board.close()

    def watcher(self) -> Watcher:
        """Return what sees the whiteboard that is there now."""
        if not self._board.alive:
            self._board.close()
            self._open()
        return self._watcher


def show(board: LiveBoard, processes: Processes, title: str, seconds: float | None) -> None:
    """Show a demo for so long: as a picture on a terminal, else a line for each change."""
    started = time.monotonic()
    until = float("inf") if seconds is None else started + seconds

    def timed(line: str) -> str:
        return f"{time.monotonic() - started:6.1f} s  {line}"

    if sys.stdout.isatty():
        from rich.live import Live

        news: deque[str] = deque(maxlen=_NEWS)
        with Live(auto_refresh=False) as live:
            while time.monotonic() < until:
                news.extend(map(timed, _reports(processes)))
                shown = _picture(board.watcher(), title, processes.standings(), news)
                live.update(shown, refresh=True)
                processes.wait(_FRAME_S)
        return
    click.echo(title)
    told: dict[str, str] = {}
    while time.monotonic() < until:
        for report in _reports(processes):
            click.echo(timed(report))
        watcher = board.watcher()
        pose = watcher.pose()
        where = "" if pose is None else f"  turtle1 at ({pose.x:.2f}, {pose.y:.2f})"
        states = {machine.name: machine.state for machine in watcher.machines()}
        for machine, state in states.items():
            if told.get(machine) != state:
                click.echo(timed(f"{machine}: {state}{where}"))
        told = states
        processes.wait(_FRAME_S / 2)


def _reports(processes: Processes) -> Iterator[str]:
    while processes.reports:
        yield processes.reports.popleft()


def _picture(
    watcher: Watcher, title: str, processes: Sequence[Standing], news: Sequence[str]
) -> RenderableType:
    """Return all that `watcher` sees, to be shown on a terminal, with what became of processes."""
    from rich.columns import Columns
    from rich.console import Group
    from rich.panel import Panel
    from rich.table import Table
    from rich.text import Text

    machines = Table.grid(padding=(0, 2))
    for machine in watcher.machines():
        style = "yellow" if machine.suspended else "bold green"
        machines.add_row(machine.name, Text(machine.state, style), f"{machine.in_state_s:5.1f} s")
    running = Table.grid(padding=(0, 2))
    for name, pid, since_s, said in processes:
        state = Text("starts again", "bold red") if pid is None else Text(f"process {pid}", "green")
        running.add_row(name, state, f"{since_s:5.0f} s", Text(said, "dim", no_wrap=True))
    pose = watcher.pose()
    board = Table.grid(padding=(0, 2))
    for name, sample, rate in watcher.slots():
        value = Text(_short(sample.message), overflow="ellipsis", no_wrap=True)
        board.add_row(Text(name, "cyan"), f"{sample.count:>6}", f"{rate:5.1f}/s", value)
    top: list[RenderableType] = [Panel(machines, title="machines", title_align="left")]
    if pose is not None:
        where = f"turtle1 at ({pose.x:.2f}, {pose.y:.2f})"
        top.append(Panel(_field(watcher, pose), title=where, title_align="left"))
    return Group(
        Text(title, "bold"),
        Columns(top),
        Panel(running, title="processes", title_align="left"),
        Panel(board, title="whiteboard", title_align="left"),
        *(Text(line, "red") for line in news),
    )


def _field(watcher: Watcher, pose: Pose) -> str:
    rows = [[" "] * _COLUMNS for _ in range(_ROWS)]
    for column, row in watcher.trail:
        rows[row][column] = "·"
    column, row = _cell(pose)
    rows[row][column] = _ARROWS[round(pose.theta / (math.pi / 4)) % 8]
    return "\n".join("".join(cells) for cells in rows)


def _cell(pose: Pose) -> tuple[int, int]:
    column = int(pose.x / _FIELD * _COLUMNS)
    row = int((1 - pose.y / _FIELD) * _ROWS)
    return min(max(column, 0), _COLUMNS - 1), min(max(row, 0), _ROWS - 1)


def _short(message: Message) -> str:
    def rounded(value: Any) -> Any:
        if isinstance(value, dict):
            return {key: rounded(inner) for key, inner in value.items()}
        return round(value, 2) if isinstance(value, float) else value

    text = json.dumps(rounded(to_plain(message)), ensure_ascii=False)
    return text.replace('"', "").strip("{}")
