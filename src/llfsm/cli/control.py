"""``llfsm ps``, ``suspend``, ``resume``, ``restart`` and ``stop``: machines of any process."""

from __future__ import annotations

import json
import time
from collections.abc import Callable

import click

from llfsm.runtime.engine.events import Status
from llfsm.runtime.presence.remote import SILENT_S, Directory, RemoteMachine, is_live
from llfsm.whiteboard import Board, BoardNotFoundError, Whiteboard, WhiteboardError
from llfsm.whiteboard.messages.llfsm import Action, MachineStatus, status_slot
from llfsm.whiteboard.shared import boards

from .options import board_option

__all__ = ["ps", "restart", "resume", "stop", "suspend"]

_PATIENCE_S = 5.0  # a machine's turn may be that far away; one in a longer period takes longer
_HEADS = ("MACHINE", "STATE", "STATUS", "SINCE", "RINGLETS", "OVERRUNS", "PID")


@click.command()
@board_option
@click.option("-a", "--all", "every", is_flag=True, help="Those on every whiteboard of this host.")
@click.option("--json", "as_json", is_flag=True, help="One JSON object a machine and line.")
def ps(board: str, every: bool, as_json: bool) -> None:
    """List the machines that run, in whatever process.

    A machine whose process stands still, or has not ended a ringlet for a second, is `silent`.

    \b
    llfsm ps
    llfsm ps -a --json
    """
    names = [info.name for info in boards() if info.used] if every else [board]
    rows = []
    for name in names:
        try:
            with Whiteboard(name, create=False) as wb:
                rows += [(name, machine) for machine in Directory(wb).machines()]
        except BoardNotFoundError:
            if not every:  # else it has gone since it was listed
                raise
        except WhiteboardError as error:
            if not every:
                raise
            click.echo(f"whiteboard {name!r}: {error}", err=True)
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


def _status(machine: RemoteMachine) -> str:
    if machine.silent_s > SILENT_S:
        return "silent"
    return "suspended" if machine.suspended else "running"


def _row(machine: RemoteMachine) -> tuple[str, ...]:
    told = machine.told
    return (
        machine.name,
        told.state,
        _status(machine),
        f"{machine.in_state_s:.1f} s",
        str(told.ringlets),
        str(told.overruns),
        str(told.pid),
    )


def _plain(board: str, machine: RemoteMachine) -> dict[str, object]:
    told = machine.told
    return {
        "whiteboard": board,
        "machine": machine.name,
        "state": told.state,
        "status": _status(machine),
        "in_state_s": round(machine.in_state_s, 3),
        "silent_s": round(machine.silent_s, 3),
        "ringlets": told.ringlets,
        "overruns": told.overruns,
        "pid": told.pid,
        "host": told.host,
    }


def _command(
    action: Action, what: str, done: Callable[[MachineStatus], bool], became: str
) -> click.Command:
    """Return the command that asks a machine for `action` and waits until it is `done`."""

    @click.command(action, help=f"{what}\n\n\b\nllfsm {action} RosPingPong\n")
    @click.argument("machine")
    @board_option
    def command(machine: str, board: str) -> None:
        with Whiteboard(board, create=False) as wb:
            remote = Directory(wb).find(machine)
            if remote.request(action) is Status.ERROR:
                raise click.ClickException(f"{machine} is about to restart; try again after that")
            state = _wait(wb, machine, remote, done)
        click.echo(f"{machine} {became}" + (f" in {state}" if state else ""))

    return command


def _wait(
    board: Board, name: str, before: RemoteMachine, done: Callable[[MachineStatus], bool]
) -> str:
    """Return the machine's state once it has done what was asked for, or "" if it is gone."""
    slot = board[status_slot(name)]
    sample, until = slot.sample(), time.monotonic() + _PATIENCE_S
    while sample is not None and is_live(sample):
        status = sample.message
        if status.obeyed > before.told.obeyed and not status.pending and done(status):
            return status.state
        left = until - time.monotonic()
        if left <= 0:
            raise click.ClickException(
                f"{name} was asked for it, but has not done it for {_PATIENCE_S:g} s; it is in "
                f"{status.state}, see `llfsm ps`"
            )
        sample = slot.wait(after=sample.count, timeout=min(left, SILENT_S)) or slot.sample()
    if done(MachineStatus(loaded=False)):
        return ""
    raise click.ClickException(f"{name} has ended meanwhile")


def _is_suspended(status: MachineStatus) -> bool:
    return status.loaded and status.suspended


def _is_running(status: MachineStatus) -> bool:
    return status.loaded and not status.suspended


def _is_gone(status: MachineStatus) -> bool:
    return not status.loaded


suspend = _command(
    "suspend",
    "Suspend a machine at its next turn, in whatever process it runs.",
    _is_suspended,
    "is suspended",
)
resume = _command(
    "resume",
    "Return a suspended machine to where it was, at its next turn.",
    _is_running,
    "is running",
)
restart = _command(
    "restart",
    "Start a machine again from its initial state, at its next turn.",
    _is_running,
    "is running again",
)
stop = _command(
    "stop",
    "Ask a machine to end: if it has not after a second, it is unloaded.\n\nThe machines beside "
    "it go on.",
    _is_gone,
    "has ended",
)
