"""``llfsm suspend``, ``resume``, ``restart``, ``reload``, ``stop``: requests to any machine."""

from __future__ import annotations

from typing import NamedTuple

import click

from llfsm.runtime.engine.events import Status
from llfsm.runtime.presence.hosts import find_machine
from llfsm.whiteboard import Board
from llfsm.whiteboard.messages.llfsm import Action, MachineStatus

from .options import BoardPlace, board_option

__all__ = ["carry_out", "reload", "restart", "resume", "stop", "suspend"]

_LOADING_S = 60.0  # a bundle may include what takes long to import


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
    "reload": _Outcome(loaded=True, suspended=False, text="is reloaded and running again"),
    "stop": _Outcome(loaded=False, suspended=False, text="has ended"),
}


def carry_out(board: Board, name: str, action: Action, *, patience_s: float | None = None) -> str:
    """Request `action` of a machine and wait until it has taken effect.

    Return the state it is in then, "" if it has ended. Raise `UnknownMachineError` if there is no
    such machine, and ``click.ClickException`` if it does not obey within `patience_s` seconds (by
    default `PATIENCE_S`), refuses to or ends instead.
    """
    outcome = _OUTCOMES[action]
    remote = find_machine(board, name)
    if remote.request(action) is Status.ERROR:
        raise click.ClickException(f"{name} is about to restart; try again after that")
    status = remote.status
    try:
        for status in remote.statuses(patience_s):
            if status.obeyed > remote.status.obeyed and not status.pending:
                if action == "reload" and status.refusal:
                    raise click.ClickException(f"{name} is not reloaded: {status.refusal}")
                if outcome.holds(status):
                    return status.state
                if status.failed and not outcome.suspended:
                    again = "again" if remote.status.failed else "then"
                    raise click.ClickException(f"{name} has failed {again}: {status.error}")
    except TimeoutError as error:
        does = "is paused: try `llfsm continue`" if status.paused else "see `llfsm ps`"
        raise click.ClickException(
            f"{name} did not carry out the request {error}; it is in {status.state}, {does}"
        ) from error
    if outcome.loaded:
        raise click.ClickException(f"{name} has ended in the meantime")
    return ""


def _command(action: Action, text: str) -> click.Command:
    """Return the command for an action; `text` begins its help."""

    @click.command(action, help=f"{text}\n\n\b\nllfsm {action} RosPingPong\n")
    @click.argument("machine")
    @board_option
    def command(machine: str, board: BoardPlace) -> None:
        with board.open(create=False) as wb:
            status = find_machine(wb, machine).status
            if status.failed:
                click.echo(f"{machine} had failed: {status.error}")
            patience_s = _LOADING_S if action == "reload" else None
            state = carry_out(wb, machine, action, patience_s=patience_s)
        click.echo(f"{machine} {_OUTCOMES[action].text}" + (f" in {state}" if state else ""))

    return command


suspend = _command("suspend", "Suspend a machine at its next turn, whichever process runs it.")
resume = _command("resume", "Return a suspended machine to its last state, at its next turn.")
restart = _command("restart", "Restart a machine from its initial state, at its next turn.")
reload = _command(
    "reload",
    "Restart a machine from the current version of its bundle.\n\n"
    "The bundle is read from the folder from which the machine was loaded. Meanwhile, the machine "
    "takes its turns; if the bundle has an error, it goes on as it is.",
)
stop = _command(
    "stop",
    "Stop a running machine; if it has not ended after a second, it is unloaded.\n\n"
    "Other machines of its process go on.",
)
