"""``llfsm ps``: the running machines of all processes."""

from __future__ import annotations

import json
from collections.abc import Iterable

import click

from llfsm.runtime.presence.remote import Directory, RemoteMachine
from llfsm.whiteboard import BoardNotFoundError, Whiteboard, WhiteboardError
from llfsm.whiteboard.shared import boards

from .options import board_option

__all__ = ["machines_on", "ps"]

_HEADS = ("MACHINE", "STATE", "STATUS", "SINCE", "RINGLETS", "OVERRUNS", "PID")


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
    if every:
        rows = machines_on(info.name for info in boards() if info.used)
    else:
        with Whiteboard(board, create=False) as wb:
            rows = [(board, machine) for machine in Directory(wb).machines()]
    if as_json:
        for name, machine in rows:
            click.echo(json.dumps(_plain(name, machine)))
        return
    lines: list[tuple[str, ...]] = [("WHITEBOARD", *_HEADS) if every else _HEADS]
    lines += [(name, *_row(machine)) if every else _row(machine) for name, machine in rows]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    for line in lines:
        padded = (text.ljust(width) for text, width in zip(line, widths, strict=True))
        click.echo("  ".join(padded).rstrip())
    for _, machine in rows:
        if machine.status.error:
            how = "hangs in" if machine.status.hung else "failed:"
            click.echo(f"{machine.name} {how} {machine.status.error}")


def machines_on(names: Iterable[str]) -> list[tuple[str, RemoteMachine]]:
    """Return the machines on whiteboards, each with the name of its whiteboard.

    A whiteboard that no longer exists is skipped; one that cannot be read is reported on standard
    error.
    """
    found = []
    for name in names:
        try:
            with Whiteboard(name, create=False) as wb:
                found += [(name, machine) for machine in Directory(wb).machines()]
        except BoardNotFoundError:
            continue
        except WhiteboardError as error:
            click.echo(f"whiteboard {name!r}: {error}", err=True)
    return found


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
    )


def _plain(board: str, machine: RemoteMachine) -> dict[str, object]:
    status = machine.status
    return {
        "whiteboard": board,
        "machine": machine.name,
        "state": status.state,
        "status": machine.condition,
        "in_state_s": round(machine.in_state_s, 3),
        "silent_s": round(machine.silent_s, 3),
        "ringlets": status.ringlets,
        "overruns": status.overruns,
        "pid": status.pid,
        "host": status.host,
        "error": status.error,
        "error_state": status.error_state,
        "error_s": round(status.error_s + machine.silent_s, 3) if status.failed else None,
    }
