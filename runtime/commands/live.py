"""A running demo on the terminal, all of it pulled from the whiteboard."""

from __future__ import annotations

import json
import math
import time
from typing import TYPE_CHECKING, Any, NamedTuple

from llfsm.whiteboard import BoundSlot, Message, Sample, Whiteboard
from llfsm.whiteboard.messages.llfsm import MACHINES, MachineStatus, status_slot
from llfsm.whiteboard.messages.turtlesim import Pose
from llfsm.whiteboard.schema import to_plain
from llfsm.whiteboard.slots import Slot

if TYPE_CHECKING:
    from rich.console import RenderableType

__all__ = ["Watcher", "picture"]

_FIELD = 11.09  # metres
_COLUMNS, _ROWS = 44, 18
_ARROWS = "→↗↑↖←↙↓↘"
_RATE_S = 1.0  # over which changes are counted


class Machine(NamedTuple):
    """Where a machine stands."""

    name: str
    status: MachineStatus
    since_s: float
    """Seconds since it has entered its state."""


class Watcher:
    """Pull all there is on a board, as often as somebody looks."""

    def __init__(self, board: Whiteboard) -> None:
        self._board = board
        self._slots: dict[str, BoundSlot[Any]] = {}
        self._counted: dict[str, tuple[float, int]] = {}
        self._rates: dict[str, float] = {}
        self.trail: dict[tuple[int, int], None] = {}

    def machines(self) -> list[Machine]:
        """Return the machines that are told of on the board."""
        self._find_slots()
        found = []
        for name, slot in self._slots.items():
            sample: Sample[MachineStatus] | None = slot.sample()
            if name.startswith(MACHINES) and sample is not None:
                age_s = (time.monotonic_ns() - sample.stamp_ns) / 1e9
                since_s = sample.message.in_state_s + age_s
                found.append(Machine(name.removeprefix(MACHINES), sample.message, since_s))
        return found

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


def picture(watcher: Watcher, title: str) -> RenderableType:
    """Return all that `watcher` sees, to be shown on a terminal."""
    from rich.columns import Columns
    from rich.console import Group
    from rich.panel import Panel
    from rich.table import Table
    from rich.text import Text

    machines = Table.grid(padding=(0, 2))
    for machine in watcher.machines():
        style = "yellow" if machine.status.suspended else "bold green"
        machines.add_row(
            machine.name, Text(machine.status.state, style), f"{machine.since_s:5.1f} s"
        )
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
        Text(title, "bold"), Columns(top), Panel(board, title="whiteboard", title_align="left")
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
