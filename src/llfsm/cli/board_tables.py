"""A board and its machines as tables on the terminal, polled from the whiteboard."""

from __future__ import annotations

import json
import math
import time
from typing import TYPE_CHECKING, Any, NamedTuple, cast

from llfsm.runtime.presence.remote import Directory, RemoteMachine
from llfsm.runtime.presence.shown import Shown
from llfsm.whiteboard import Board, Message, Sample
from llfsm.whiteboard.messages.llfsm import status_slot
from llfsm.whiteboard.messages.turtlesim import Pose
from llfsm.whiteboard.own_slots import is_own
from llfsm.whiteboard.poller import BoardPoller, is_data
from llfsm.whiteboard.schema import to_plain

if TYPE_CHECKING:
    from collections.abc import Iterable

    from rich.console import RenderableType

__all__ = ["SlotRow", "Watcher", "machine_table", "slot_table", "turtle_field"]

_FIELD = 11.09  # metres
_COLUMNS, _ROWS = 44, 18
_ARROWS = "→↗↑↖←↙↓↘"
_STYLES = {
    "running": "bold green",
    "suspended": "yellow",
    "paused": "bold magenta",
    "failed": "bold red",
    "hung": "bold red",
    "silent": "red",
}
_RATE_S = 1.0  # over which changes are counted


class SlotRow(NamedTuple):
    """A slot as of the latest poll."""

    name: str
    sample: Sample[Message] | None
    rate: float
    """Changes per second."""
    problem: str = ""
    """Why its message cannot be shown."""

    @property
    def age_s(self) -> float:
        """Seconds since the latest message was added; infinite if none was."""
        if self.sample is None:
            return math.inf
        return (time.monotonic_ns() - self.sample.stamp_ns) / 1e9


class Watcher:
    """Poll everything on a board that is shown; by default all."""

    def __init__(self, board: Board, shown: Shown | None = None) -> None:
        self._directory = Directory(board)
        self._shown = shown or Shown(board)
        self._poller = BoardPoller(board, wants=self._is_shown)
        self._counted: dict[str, tuple[float, int]] = {}
        self._rates: dict[str, float] = {}
        self.trail: dict[tuple[int, int], None] = {}

    def machines(self) -> list[RemoteMachine]:
        """Return the machines that run on the board, or on the host that is shown."""
        found = self._directory.machines()
        return [each for each in found if self._shown.has(status_slot(each.name).name)]

    def pose(self) -> Pose | None:
        """Return the pose of turtle1, and add it to the trail."""
        self._poller.poll()
        slot = self._poller.slots.get("turtle1/pose")
        if slot is None or slot.sample is None:
            return None
        pose = cast(Pose, slot.sample.message)
        self.trail[_cell(pose)] = None
        return pose

    def slots(self) -> list[SlotRow]:
        """Return all slots but those of llfsm's own processes."""
        self._shown.look()
        self._poller.poll()
        return [
            SlotRow(slot.name, slot.sample, self._rate(slot.name, slot.count), slot.problem)
            for slot in self._poller.slots.values()
        ]

    def _is_shown(self, slot: str) -> bool:
        return is_data(slot) and not is_own(slot) and self._shown.has(slot)

    def _rate(self, name: str, count: int) -> float:
        now = time.monotonic()
        then, before = self._counted.setdefault(name, (now, count))
        if now - then >= _RATE_S:
            self._rates[name] = (count - before) / (now - then)
            self._counted[name] = now, count
        return self._rates.get(name, 0.0)


def machine_table(machines: Iterable[RemoteMachine], *, wide: bool = False) -> RenderableType:
    """Return machines with their states; `wide` adds the columns of `llfsm ps`."""
    from rich.table import Table
    from rich.text import Text

    table = Table.grid(padding=(0, 2))
    for machine in machines:
        style = _STYLES[machine.condition]
        row: list[RenderableType] = [
            Text(machine.name),
            Text(machine.state, style),
            f"{machine.in_state_s:6.1f} s",
        ]
        if wide:
            status = machine.status
            overruns = Text(f"{status.overruns} overruns", "red" if status.overruns else "dim")
            row += [
                Text(machine.condition, style),
                f"{status.ringlets} ringlets",
                overruns,
                f"pid {status.pid}",
            ]
        table.add_row(*row)
        if wide and machine.status.error:
            table.add_row("", Text(machine.status.error, "red"))
    return table


def slot_table(slots: Iterable[SlotRow], *, wide: bool = False) -> RenderableType:
    """Return slots with their values; `wide` adds their age and writer."""
    from rich.table import Table
    from rich.text import Text

    table = Table.grid(padding=(0, 2))
    for slot in slots:
        sample = slot.sample
        value = Text(_short(sample.message)) if sample else Text(slot.problem or "-", "red")
        value.overflow, value.no_wrap = "ellipsis", True
        count = "-" if sample is None else str(sample.count)
        row: list[RenderableType] = [Text(slot.name, "cyan"), f"{count:>6}", f"{slot.rate:5.1f}/s"]
        if wide:
            stale = slot.age_s > 1 and slot.rate == 0
            row.append(Text(f"{slot.age_s:6.1f} s" if sample else "", "dim" if stale else ""))
            row.append(f"pid {sample.writer}" if sample else "")
        table.add_row(*row, value)
    return table


def turtle_field(watcher: Watcher, pose: Pose) -> str:
    """Return the field of turtle1 as lines of text: its pose and its trail."""
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
    return text[1:-1].replace('"', "")
