"""``llfsm ps`` and ``llfsm top``: whiteboards and their machines as tables on the terminal."""

from __future__ import annotations

import json
import math
import shlex
import sys
import time
from collections.abc import Iterable, Iterator
from contextlib import ExitStack
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import click
from msgspec.structs import astuple

from llfsm.cli.echo import echo
from llfsm.cli.options import BoardPlace, board_option, fleet_option, host_option
from llfsm.errors import printable
from llfsm.runtime.engine.realtime import stop_on_signals
from llfsm.runtime.presence.hosts import FleetReader, HostNames, Shown
from llfsm.runtime.presence.remote import Directory, RemoteMachine, pause_text, shown_fields
from llfsm.runtime.presence.slot_ownership import contested_slots, described
from llfsm.whiteboard import Board, BoardNotFoundError, Message, Sample, WhiteboardError
from llfsm.whiteboard.messages.llfsm import Commander, status_slot
from llfsm.whiteboard.messages.turtlesim import Pose
from llfsm.whiteboard.poller import BoardPoller, is_data
from llfsm.whiteboard.schema import to_plain
from llfsm.whiteboard.shared import boards
from llfsm.whiteboard.slot_names import is_own

if TYPE_CHECKING:
    from rich.console import RenderableType
    from rich.text import Text


class Listing(NamedTuple):
    """The machines of one whiteboard, as `ps` lists them."""

    board: str
    machines: list[RemoteMachine]
    hosts: HostNames
    contested: dict[str, list[Commander]]
    """The machines that command one slot, by slot, where there are several."""


_HEADS = (
    "MACHINE",
    "STATE",
    "STATUS",
    "SINCE",
    "RINGLETS",
    "OVERRUNS",
    "PID",
    "REALTIME",
    "WAITS FOR",
)


@click.command()
@board_option
@click.option(
    "-a", "--all", "every", is_flag=True, help="List machines on every whiteboard of this host."
)
@click.option(
    "--fleet", is_flag=True, help="List machines of all hosts, with a column for the host."
)
@host_option
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object per machine and line.")
def ps(board: BoardPlace, every: bool, fleet: bool, host: str, as_json: bool) -> None:
    """List the running machines of all processes.

    A machine is `silent` if its process is stopped or has not ended a ringlet for a second.
    Machines of other hosts are listed if they are mirrored here; --fleet and --host request them.

    \b
    llfsm ps
    llfsm ps -a --json
    llfsm ps --fleet
    llfsm ps --host robot7
    """
    if every and (fleet or host):
        raise click.UsageError(
            "-a is for the whiteboards of this host; leave out --fleet or --host"
        )
    there = boards(board.directory) if every else ()
    used = (board._replace(name=info.name) for info in there if info.used)
    found = listings(used) if every else [_listing(board, fleet=fleet, host=host)]
    nested = [(each, *row) for each in found for row in depth_first(each.machines)]
    rows = [(listing, machine) for listing, _, machine in nested]
    if as_json:
        for row in rows:
            echo(json.dumps(_plain(*row)))
        return
    first = ("WHITEBOARD",) if every else ("HOST",) if fleet else ()
    lines: list[tuple[str, ...]] = [(*first, *_HEADS)]
    for listing, depth, machine in nested:
        of = listing.hosts.of_machine(machine.name) or machine.status.host
        first = (listing.board,) if every else (of,) if fleet else ()
        lines.append((*first, *_row(machine, depth)))
    for place in (-2, -1):  # columns that are there if anything is in them
        if not any(line[place] for line in lines[1:]):
            lines = [(*line[:place], *line[len(line) + place + 1 :]) for line in lines]
    if not rows:
        echo(_none(board, every=every, fleet=fleet, host=host))
        lines = []
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    for line in lines:
        padded = (text.ljust(width) for text, width in zip(line, widths, strict=True))
        echo("  ".join(padded).rstrip())
    for _, machine in rows:
        if machine.status.error:
            how = "hangs in" if machine.status.hung else "failed:"
            echo(f"{machine.name} {how} {machine.status.error}")
        if machine.status.refusal:
            echo(f"{machine.name} is not reloaded: {machine.status.refusal}")
        if machine.status.caller and not machine.name.startswith(f"{machine.status.caller}/"):
            echo(f"{machine.name} is called by {machine.status.caller}")
        for sensor, left_s in _overrides(machine).items():
            until = "until it is released" if left_s is None else f"for {left_s:.0f} s more"
            echo(f"{machine.name}: its sensor {sensor} is overridden, {until}")
    for machine in {machine.status.pid: machine for _, machine in rows}.values():
        if why := machine.status.paused:
            echo(f"the machines of process {machine.status.pid} are paused: {why}")
            echo(f"  {pause_text(machine.status, machine.silent_s)}")
    for listing in found:
        for slot, commanders in listing.contested.items():
            echo(described(slot, commanders))


def _none(board: BoardPlace, *, every: bool, fleet: bool, host: str) -> str:
    """Return the sentence for an empty list, with the command that starts a machine."""
    if every:
        return "no machine runs on a whiteboard of this host; start one: llfsm run MACHINE"
    where = f" of host {host}" if host else " of any host" if fleet else ""
    name = shlex.quote(board.name)
    return f"no machine{where} runs on whiteboard {name}; start one: llfsm run MACHINE -b {name}"


def listings(places: Iterable[BoardPlace]) -> list[Listing]:
    """List the machines on whiteboards; skip those that are gone, report those that are damaged."""
    found = []
    for place in places:
        try:
            found.append(_listing(place))
        except BoardNotFoundError:
            continue
        except WhiteboardError as error:
            echo(f"whiteboard {place.name!r}: {error}", err=True)
    return found


def _listing(place: BoardPlace, *, fleet: bool = False, host: str = "") -> Listing:
    with place.open(create=False) as wb, ExitStack() as stack:
        names = HostNames(wb)
        if fleet or host:
            require_host(stack.enter_context(FleetReader(wb, host, machines=True)))
        machines = Directory(wb).machines()
        if host:
            machines = [each for each in machines if names.of_machine(each.name) == host]
        return Listing(place.name, machines, names, contested_slots(wb))


def shown_of(board: Board, host: str, *, fleet: bool = False) -> Shown:
    """Select the slots of a board to show, by host or for the fleet; raise as `require_host`."""
    shown = Shown(board, host, fleet=fleet)
    if shown.fleet is not None:
        require_host(shown.fleet)
    return shown


def require_host(fleet: FleetReader) -> None:
    """Wait until hosts are read; raise ``click.ClickException`` for one that cannot be."""
    fleet.settle()
    problem = fleet.problem()
    if problem:
        raise click.ClickException(problem)


def depth_first(machines: Iterable[RemoteMachine]) -> Iterator[tuple[int, RemoteMachine]]:
    """Yield how many machines each one is inside of, and each; its own inner ones come next.

    Whatever their statuses say of their callers, each comes once: any process may write these.
    """
    left = {(each.status.pid, each.name): each for each in machines}
    inner: dict[tuple[int, str], list[RemoteMachine]] = {}
    for each in left.values():
        inner.setdefault((each.status.pid, each.status.caller), []).append(each)
    outermost = [each for of, group in inner.items() if of not in left for each in group]
    first = sorted(outermost, key=lambda each: each.name)
    todo = [(0, each) for each in (*first, *left.values())][::-1]  # the rest calls each other
    while todo:
        depth, machine = todo.pop()
        of = machine.status.pid, machine.name
        if left.pop(of, None) is not None:
            yield depth, machine
            todo += [(depth + 1, each) for each in inner.get(of, ())[::-1]]


def _row(machine: RemoteMachine, depth: int) -> tuple[str, ...]:
    status = machine.status
    core = "" if status.cpu < 0 else f" on core {status.cpu}"
    return (
        "  " * depth + machine.name,
        status.state,
        machine.condition,
        f"{machine.in_state_s:.1f} s",
        str(status.ringlets),
        str(status.overruns),
        str(status.pid),
        f"FIFO {status.realtime}{core}" if status.realtime else "",
        status.waits,
    )


def _overrides(machine: RemoteMachine) -> dict[str, float | None]:
    """Return the overridden sensors, with the seconds that are left of each; None for no end."""
    silent_s = machine.silent_s
    return {
        sensor: _left_s(left_s, silent_s)
        for sensor, left_s in map(astuple, machine.status.overridden)
    }


def _left_s(left_s: float | None, silent_s: float) -> float | None:
    return None if left_s is None else max(0.0, round(left_s - silent_s, 3))


# What --json prints of a machine's status as it is published.
def _plain(listing: Listing, machine: RemoteMachine) -> dict[str, object]:
    status, silent_s = machine.status, machine.silent_s  # one look at the clock for all times
    return {
        "whiteboard": listing.board,
        "machine": machine.name,
        **shown_fields(status),
        "status": machine.condition,
        "in_state_s": round(status.in_state_s + silent_s, 3),
        "silent_s": round(silent_s, 3),
        "as": listing.hosts.of_machine(machine.name) or None,
        "realtime": status.realtime or None,
        "cpu": None if status.cpu < 0 else status.cpu,
        "paused_left_s": _left_s(status.paused_left_s, silent_s),
        "overridden": _overrides(machine),
        "error_s": round(status.error_s + silent_s, 3) if status.failed else None,
        "contested": [
            slot
            for slot, commanders in listing.contested.items()
            if (machine.name, status.pid) in ((each.machine, each.pid) for each in commanders)
        ],
    }


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
    rate: float  # changes per second
    problem: str = ""  # why its message cannot be shown

    @property
    def age_s(self) -> float:
        """Seconds since the latest message was added; infinite if none was."""
        if self.sample is None:
            return math.inf
        return (time.monotonic_ns() - self.sample.stamp_ns) / 1e9


class Watcher:
    """Poll the slots and machines of a board that are `shown`, by default all."""

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
        """Return the pose of turtle1, if there is one, and add it to the trail."""
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


def _shown(text: str, style: str = "") -> Text:
    """Make the text of a cell, which may come from others."""
    from rich.text import Text

    return Text(printable(text), style)


def machine_table(machines: Iterable[RemoteMachine], *, wide: bool = False) -> RenderableType:
    """Make a table of machines and their states; `wide` adds the columns of `llfsm ps`."""
    from rich.table import Table

    table = Table.grid(padding=(0, 2))
    for depth, machine in depth_first(machines):
        style = _STYLES[machine.condition]
        row: list[RenderableType] = [
            _shown("  " * depth + machine.name),
            _shown(machine.state, style),
            f"{machine.in_state_s:6.1f} s",
        ]
        if wide:
            status = machine.status
            overruns = _shown(f"{status.overruns} overruns", "red" if status.overruns else "dim")
            row += [
                _shown(machine.condition, style),
                f"{status.ringlets} ringlets",
                overruns,
                f"pid {status.pid}",
            ]
        table.add_row(*row)
        if wide and machine.status.error:
            table.add_row("", _shown(machine.status.error, "red"))
    return table


def slot_table(slots: Iterable[SlotRow], *, wide: bool = False) -> RenderableType:
    """Make a table of slots and their values; `wide` adds their age and writer."""
    from rich.table import Table

    table = Table.grid(padding=(0, 2))
    for slot in slots:
        sample = slot.sample
        value = _shown(_short(sample.message)) if sample else _shown(slot.problem or "-", "red")
        value.overflow, value.no_wrap = "ellipsis", True
        count = "-" if sample is None else str(sample.count)
        row: list[RenderableType] = [
            _shown(slot.name, "cyan"),
            f"{count:>6}",
            f"{slot.rate:5.1f}/s",
        ]
        if wide:
            stale = slot.age_s > 1 and slot.rate == 0
            row.append(_shown(f"{slot.age_s:6.1f} s" if sample else "", "dim" if stale else ""))
            row.append(f"pid {sample.writer}" if sample else "")
        table.add_row(*row, value)
    return table


def turtle_field(watcher: Watcher, pose: Pose) -> str:
    """Draw the field of turtle1 as lines of text: its pose and its trail."""
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
        echo(line.rstrip())


def _screen(watcher: Watcher, board: str) -> RenderableType:
    from rich.console import Group

    machines, slots = watcher.machines(), watcher.slots()
    title = f"whiteboard {board}, machines: {len(machines)}, slots: {len(slots)}"
    parts: list[RenderableType] = [_shown(title, "bold")]
    if machines:
        parts += ["", machine_table(machines, wide=True)]
    if slots:
        parts += ["", slot_table(slots, wide=True)]
    return Group(*parts)
