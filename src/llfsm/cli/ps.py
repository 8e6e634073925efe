"""``llfsm ps``: the running machines of all processes."""

from __future__ import annotations

import json
import shlex
from collections.abc import Iterable
from contextlib import ExitStack
from typing import NamedTuple

import click
from msgspec.structs import astuple

from llfsm.runtime.presence.commanders import contested_slots, described
from llfsm.runtime.presence.hosts import FleetReader, HostNames
from llfsm.runtime.presence.remote import Directory, RemoteMachine, pause_text
from llfsm.runtime.presence.shown import Shown
from llfsm.whiteboard import Board, BoardNotFoundError, WhiteboardError
from llfsm.whiteboard.messages.llfsm import Commander, MachineStatus
from llfsm.whiteboard.shared import boards

from .options import BoardPlace, board_option, host_option

__all__ = ["listings", "ps", "shown_of"]


class Listing(NamedTuple):
    """What `ps` shows of one whiteboard."""

    board: str
    machines: list[RemoteMachine]
    hosts: HostNames
    contested: dict[str, list[Commander]]
    """The machines that command one slot, by slot, where there are several."""


_HEADS = ("MACHINE", "STATE", "STATUS", "SINCE", "RINGLETS", "OVERRUNS", "PID", "REALTIME")


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
    if as_json:
        for listing in found:
            for machine in listing.machines:
                click.echo(json.dumps(_plain(listing, machine)))
        return
    rows = [(listing.board, machine) for listing in found for machine in listing.machines]
    first = ("WHITEBOARD",) if every else ("HOST",) if fleet else ()
    lines: list[tuple[str, ...]] = [(*first, *_HEADS)]
    for listing in found:
        for machine in listing.machines:
            of = listing.hosts.of_machine(machine.name) or machine.status.host
            first = (listing.board,) if every else (of,) if fleet else ()
            lines.append((*first, *_row(machine)))
    if not any(machine.status.realtime for _, machine in rows):
        lines = [line[:-1] for line in lines]
    if not rows:
        click.echo(_none(board, every=every, fleet=fleet, host=host))
        lines = []
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    for line in lines:
        padded = (text.ljust(width) for text, width in zip(line, widths, strict=True))
        click.echo("  ".join(padded).rstrip())
    for _, machine in rows:
        if machine.status.error:
            how = "hangs in" if machine.status.hung else "failed:"
            click.echo(f"{machine.name} {how} {machine.status.error}")
        if machine.status.refusal:
            click.echo(f"{machine.name} is not reloaded: {machine.status.refusal}")
        if machine.status.caller:
            click.echo(f"{machine.name} is called by {machine.status.caller}")
        for sensor, left_s in _overrides(machine).items():
            until = "until it is released" if left_s is None else f"for {left_s:.0f} s more"
            click.echo(f"{machine.name}: its sensor {sensor} is overridden, {until}")
    for machine in {machine.status.pid: machine for _, machine in rows}.values():
        if why := machine.status.paused:
            click.echo(f"the machines of process {machine.status.pid} are paused: {why}")
            click.echo(f"  {pause_text(machine.status, machine.silent_s)}")
    for listing in found:
        for slot, commanders in listing.contested.items():
            click.echo(described(slot, commanders))


def _none(board: BoardPlace, *, every: bool, fleet: bool, host: str) -> str:
    """Return where no machine runs, and how to start one."""
    if every:
        return "no machine runs on a whiteboard of this host; start one: llfsm run MACHINE"
    where = f" of host {host}" if host else " of any host" if fleet else ""
    name = shlex.quote(board.name)
    return f"no machine{where} runs on whiteboard {name}; start one: llfsm run MACHINE -b {name}"


def listings(places: Iterable[BoardPlace]) -> list[Listing]:
    """Return the machines on whiteboards.

    A whiteboard that no longer exists is skipped; one that cannot be read is reported on standard
    error.
    """
    found = []
    for place in places:
        try:
            found.append(_listing(place))
        except BoardNotFoundError:
            continue
        except WhiteboardError as error:
            click.echo(f"whiteboard {place.name!r}: {error}", err=True)
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
    """Return what is shown of a board; raise as `require_host` does."""
    shown = Shown(board, host, fleet=fleet)
    if shown.fleet is not None:
        require_host(shown.fleet)
    return shown


def require_host(fleet: FleetReader) -> None:
    """Wait for what is read; raise ``click.ClickException`` for a host that cannot be."""
    fleet.settle()
    problem = fleet.problem()
    if problem:
        raise click.ClickException(problem)


def _row(machine: RemoteMachine) -> tuple[str, ...]:
    status = machine.status
    return (
        machine.name,
        status.state,
        machine.condition,
        f"{machine.in_state_s:.1f} s",
        str(status.ringlets),
        str(status.overruns),
        str(status.pid),
        _scheduling(status),
    )


def _overrides(machine: RemoteMachine) -> dict[str, float | None]:
    """Return the overridden sensors, with the seconds that are left of each."""
    silent_s = machine.silent_s
    return {
        sensor: _left_s(left_s, silent_s)
        for sensor, left_s in map(astuple, machine.status.overridden)
    }


def _left_s(left_s: float | None, silent_s: float) -> float | None:
    return None if left_s is None else max(0.0, round(left_s - silent_s, 3))


def _scheduling(status: MachineStatus) -> str:
    core = "" if status.cpu < 0 else f" on core {status.cpu}"
    return f"FIFO {status.realtime}{core}" if status.realtime else ""


def _plain(listing: Listing, machine: RemoteMachine) -> dict[str, object]:
    status, silent_s = machine.status, machine.silent_s  # one look at the clock for all times
    return {
        "whiteboard": listing.board,
        "machine": machine.name,
        "state": status.state,
        "status": machine.condition,
        "in_state_s": round(status.in_state_s + silent_s, 3),
        "silent_s": round(silent_s, 3),
        "ringlets": status.ringlets,
        "overruns": status.overruns,
        "pid": status.pid,
        "host": status.host,
        "as": listing.hosts.of_machine(machine.name) or None,
        "realtime": status.realtime or None,
        "cpu": None if status.cpu < 0 else status.cpu,
        "paused": status.paused,
        "paused_left_s": _left_s(status.paused_left_s, silent_s),
        "clock": status.clock,
        "overridden": _overrides(machine),
        "caller": status.caller,
        "refusal": status.refusal,
        "error": status.error,
        "error_state": status.error_state,
        "error_s": round(status.error_s + silent_s, 3) if status.failed else None,
        "contested": [
            slot
            for slot, commanders in listing.contested.items()
            if (machine.name, status.pid) in ((each.machine, each.pid) for each in commanders)
        ],
    }
