"""``llfsm ps``: the running machines of all processes."""

from __future__ import annotations

import json
from collections.abc import Iterable
from typing import NamedTuple

import click

from llfsm.runtime.presence.commanders import contested_slots, described
from llfsm.runtime.presence.remote import Directory, RemoteMachine
from llfsm.whiteboard import BoardNotFoundError, Whiteboard, WhiteboardError
from llfsm.whiteboard.messages.llfsm import Commander, MachineStatus
from llfsm.whiteboard.shared import boards

from .options import board_option

__all__ = ["listings", "ps"]


class Listing(NamedTuple):
    """What `ps` shows of one whiteboard."""

    board: str
    machines: list[RemoteMachine]
    contested: dict[str, list[Commander]]
    """The machines that command one slot, by slot, where there are several."""


_HEADS = ("MACHINE", "STATE", "STATUS", "SINCE", "RINGLETS", "OVERRUNS", "PID", "REALTIME")


@click.command()
@board_option
@click.option("-a", "--all", "every", is_flag=True, help="Those on every whiteboard of this host.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object per machine and line.")
def ps(board: str, every: bool, as_json: bool) -> None:
    """List the running machines of all processes.

    A machine is `silent` if its process is stopped or has not ended a ringlet for a second.

    \b
    llfsm ps
    llfsm ps -a --json
    """
    used = (info.name for info in boards() if info.used)
    found = listings(used) if every else [_listing(board)]
    if as_json:
        for listing in found:
            for machine in listing.machines:
                click.echo(json.dumps(_plain(listing, machine)))
        return
    rows = [(listing.board, machine) for listing in found for machine in listing.machines]
    lines: list[tuple[str, ...]] = [("WHITEBOARD", *_HEADS) if every else _HEADS]
    lines += [(name, *_row(machine)) if every else _row(machine) for name, machine in rows]
    if not any(machine.status.realtime for _, machine in rows):
        lines = [line[:-1] for line in lines]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    for line in lines:
        padded = (text.ljust(width) for text, width in zip(line, widths, strict=True))
        click.echo("  ".join(padded).rstrip())
    for _, machine in rows:
        if machine.status.error:
            how = "hangs in" if machine.status.hung else "failed:"
            click.echo(f"{machine.name} {how} {machine.status.error}")
    for listing in found:
        for slot, commanders in listing.contested.items():
            click.echo(described(slot, commanders))


def listings(names: Iterable[str]) -> list[Listing]:
    """Return the machines on whiteboards.

    A whiteboard that no longer exists is skipped; one that cannot be read is reported on standard
    error.
    """
    found = []
    for name in names:
        try:
            found.append(_listing(name))
        except BoardNotFoundError:
            continue
        except WhiteboardError as error:
            click.echo(f"whiteboard {name!r}: {error}", err=True)
    return found


def _listing(name: str) -> Listing:
    with Whiteboard(name, create=False) as wb:
        return Listing(name, Directory(wb).machines(), contested_slots(wb))


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


def _scheduling(status: MachineStatus) -> str:
    core = "" if status.cpu < 0 else f" on core {status.cpu}"
    return f"FIFO {status.realtime}{core}" if status.realtime else ""


def _plain(listing: Listing, machine: RemoteMachine) -> dict[str, object]:
    status = machine.status
    return {
        "whiteboard": listing.board,
        "machine": machine.name,
        "state": status.state,
        "status": machine.condition,
        "in_state_s": round(machine.in_state_s, 3),
        "silent_s": round(machine.silent_s, 3),
        "ringlets": status.ringlets,
        "overruns": status.overruns,
        "pid": status.pid,
        "host": status.host,
        "realtime": status.realtime or None,
        "cpu": None if status.cpu < 0 else status.cpu,
        "error": status.error,
        "error_state": status.error_state,
        "error_s": round(status.error_s + machine.silent_s, 3) if status.failed else None,
        "contested": [
            slot
            for slot, commanders in listing.contested.items()
            if (machine.name, status.pid) in ((each.machine, each.pid) for each in commanders)
        ],
    }
