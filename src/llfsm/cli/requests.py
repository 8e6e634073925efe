"""``llfsm suspend``, ``resume``, ``restart`` and ``stop``: requests to machines of any process."""

from __future__ import annotations

import time
from typing import NamedTuple

import click

from llfsm.runtime.engine.events import Status
from llfsm.runtime.presence.remote import SILENT_S, Directory, is_live
from llfsm.whiteboard import Board, Whiteboard
from llfsm.whiteboard.messages.llfsm import Action, MachineStatus, status_slot

from .options import board_option

__all__ = ["carry_out", "restart", "resume", "stop", "suspend"]

_PATIENCE_S = 5.0  # a machine's next turn may be that far away; with a long period, further


class _Outcome(NamedTuple):
    """What holds of a machine once it has done what an action requests."""

    loaded: bool
    suspended: bool
    text: str

    def holds(self, status: MachineStatus) -> bool:
        if not self.loaded:
            return not status.loaded
        return status.loaded and status.suspended == self.suspended


_OUTCOMES: dict[Action, _Outcome] = {
    "suspend": _Outcome(loaded=True, suspended=True, text="is suspended"),
    "resume": _Outcome(loaded=True, suspended=False, text="is running"),
    "restart": _Outcome(loaded=True, suspended=False, text="is running again"),
    "stop": _Outcome(loaded=False, suspended=False, text="has ended"),
}


def carry_out(board: Board, name: str, action: Action, *, patience_s: float = _PATIENCE_S) -> str:
    """Request `action` of a machine and wait until it has taken effect.

    Return the state it is in then, "" if it has ended. Raise `UnknownMachineError` if there is no
    such machine, and ``click.ClickException`` if it does not obey within `patience_s` seconds or
    ends instead.
    """
    outcome = _OUTCOMES[action]
    remote = Directory(board).find(name)
    if remote.request(action) is Status.ERROR:
        raise click.ClickException(f"{name} is about to restart; try again after that")
    slot = board[status_slot(name)]
    sample, until = slot.sample(), time.monotonic() + patience_s
    while sample is not None and is_live(sample):
        status = sample.message
        if status.obeyed > remote.status.obeyed and not status.pending:
            if outcome.holds(status):
                return status.state
            if status.failed and not outcome.suspended:
                again = "again" if remote.status.failed else "then"
                raise click.ClickException(f"{name} has failed {again}: {status.error}")
        left = until - time.monotonic()
        if left <= 0:
            raise click.ClickException(
                f"{name} did not carry out the request within {patience_s:g} s; "
                f"it is in {status.state}, see `llfsm ps`"
            )
        sample = slot.wait(after=sample.count, timeout=min(left, SILENT_S)) or slot.sample()
    if outcome.loaded:
        raise click.ClickException(f"{name} has ended in the meantime")
    return ""


def _command(action: Action, text: str) -> click.Command:
    """Return the command for an action; `text` begins its help."""

    @click.command(action, help=f"{text}\n\n\b\nllfsm {action} RosPingPong\n")
    @click.argument("machine")
    @board_option
    def command(machine: str, board: str) -> None:
        with Whiteboard(board, create=False) as wb:
            status = Directory(wb).find(machine).status
            if status.failed:
                click.echo(f"{machine} had failed: {status.error}")
            state = carry_out(wb, machine, action)
        click.echo(f"{machine} {_OUTCOMES[action].text}" + (f" in {state}" if state else ""))

    return command


suspend = _command("suspend", "Suspend a machine at its next turn, whichever process runs it.")
resume = _command("resume", "Return a suspended machine to its last state, at its next turn.")
restart = _command("restart", "Start a machine again from its initial state, at its next turn.")
stop = _command(
    "stop",
    "Ask a machine to end; if it has not ended after a second, it is unloaded.\n\n"
    "Other machines of its process go on.",
)
