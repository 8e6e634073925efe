"""Commands that ask something of running machines, whichever process runs them.

``suspend``, ``resume``, ``restart``, ``reload`` and ``stop`` are for one machine; ``pause``,
``step`` and ``continue`` for all of its process; ``override`` for a sensor; ``why`` only asks.

A request is a message in the machine's request slot, of which only the latest is read. Each command
therefore waits until an earlier one is obeyed, and then for the status that shows its own effect:
a machine that is stopped or silent is reported, never assumed to obey.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from typing import Any, NamedTuple, TypeVar, get_args

import click

from llfsm.cli.echo import echo
from llfsm.cli.options import BoardPlace, Number, board_option
from llfsm.runtime.debugging.causes import NOT_EVALUATED
from llfsm.runtime.debugging.debugger import Step
from llfsm.runtime.debugging.leases import LEASE_S
from llfsm.runtime.engine.events import Status
from llfsm.runtime.presence.hosts import HostNames, find_machine
from llfsm.runtime.presence.remote import PATIENCE_S, SILENT_S, Directory, RemoteMachine, pause_text
from llfsm.whiteboard import Board
from llfsm.whiteboard.liveness import identity
from llfsm.whiteboard.messages.llfsm import (
    Action,
    MachineRequest,
    MachineStatus,
    MachineWhy,
    SeenTransition,
    Viewer,
    status_slot,
    why_slot,
)

_LOADING_S = 60.0  # a bundle may include what takes long to import


class _Outcome(NamedTuple):
    """The status of a machine that has carried out an action, and the text that confirms it."""

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
    """Request `action` of a machine, wait until it has taken effect, and return its state then.

    The state is "" if it has ended. Raise `UnknownMachineError` if there is no
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
    """Make the command for an action; `text` begins its help."""

    @click.command(action, help=f"{text}\n\n\b\nllfsm {action} RosPingPong\n")
    @click.argument("machine")
    @board_option
    def command(machine: str, board: BoardPlace) -> None:
        with board.open(create=False) as wb:
            status = find_machine(wb, machine).status
            if status.failed:
                echo(f"{machine} had failed: {status.error}")
            patience_s = _LOADING_S if action == "reload" else None
            state = carry_out(wb, machine, action, patience_s=patience_s)
        echo(f"{machine} {_OUTCOMES[action].text}" + (f" in {state}" if state else ""))

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


@click.command()
@click.argument("machine")
@board_option
def why(machine: str, board: BoardPlace) -> None:
    """Show why MACHINE is still in its state: each transition, with the values that it saw.

    Values are from its last turn or, if there is none, computed now. `?` marks a guard that cannot
    be evaluated without side effects or before the state is entered.

    \b
    llfsm why Wall
    """
    with board.open(create=False) as wb:
        found = find_machine(wb, machine)
        for line in why_lines(fetch_why(wb, found.name)):
            echo(line)
        if found.status.failed:
            echo(f"it has failed: {found.status.error}")


def fetch_why(board: Board, machine: str) -> MachineWhy:
    """Have a machine publish why it is in its state, within `PATIENCE_S`; return that."""
    slot, until = board[why_slot(machine)], time.monotonic() + PATIENCE_S
    names, before = HostNames(board), slot.count
    while time.monotonic() < until:
        names.ask(board, names.of_machine(machine), Viewer(os.getpid(), why=True))
        found = slot.wait(after=before, timeout=0.25)
        if found is not None:
            return found.message
        status = board.get_message(status_slot(machine))
        if status is not None and not status.loaded:  # as what a state runs does at any time
            raise click.ClickException(f"{machine} has ended")
    raise click.ClickException(f"{machine} does not answer; see `llfsm ps`")


def why_lines(why: MachineWhy) -> Iterator[str]:
    """Give the lines that `llfsm why` prints of a machine."""
    if why.source:
        yield f"it has {'failed in' if why.failed else 'left'} {why.source}:"
        yield from _table(why.before)
    if not why.transitions:
        yield f"it is in {why.state}"
        return
    when = "as it would be evaluated now"
    if why.evaluated_s is not None:
        when = f"evaluated {why.evaluated_s:.3f} s ago"
    yield f"it is in {why.state}, {when}:"
    yield from _table(why.transitions)


def _table(transitions: Iterable[SeenTransition]) -> Iterator[str]:
    rows = [
        (cause_value(each.value, each.seen), each.target, each.label, each.seen)
        for each in transitions
    ]
    target, label = (max((len(row[i]) for row in rows), default=0) for i in (1, 2))
    for row in rows:
        yield f"  {row[0]:<5}  -> {row[1]:<{target}}  {row[2]:<{label}}  {row[3]}".rstrip()


def cause_value(value: bool | None, seen: str) -> str:
    """Return the word for a transition's value: "-" if not evaluated, "?" if that is impossible."""
    if value is None:
        return "-" if seen == NOT_EVALUATED else "?"
    return "true" if value else "false"


F = TypeVar("F", bound=Callable[..., Any])

_BEFORE_S = 0.5  # how long another request may take to be obeyed

_machine = click.argument("machine", required=False)


def _lease_option(help_text: str) -> Callable[[F], F]:
    return click.option(
        "--for",
        "lease_s",
        metavar="SECONDS",
        type=Number(0, min_open=True),
        default=LEASE_S,
        show_default=True,
        help=help_text,
    )


_lease = _lease_option("Go on after SECONDS seconds, unless paused or stepped again.")


@click.command()
@_machine
@_lease
@board_option
def pause(machine: str | None, lease_s: float, board: BoardPlace) -> None:
    """Pause all machines of the process that runs MACHINE, before their next turn.

    MACHINE may be omitted if one process runs all machines.

    \b
    llfsm pause
    llfsm pause Wall --for 600
    """
    with board.open(create=False) as wb:
        status = _debug(wb, _find(wb, machine), MachineRequest("pause", "", lease_s))
        echo(f"paused in {status.state} until `llfsm continue`")
        echo(pause_text(status))


@click.command()
@_machine
@click.option(
    "--until",
    type=click.Choice(get_args(Step)),
    default="turn",
    show_default=True,
    help="Pause after a turn, a round or a transition, or when MACHINE leaves its state.",
)
@_lease
@board_option
def step(machine: str | None, until: Step, lease_s: float, board: BoardPlace) -> None:
    """Let all machines of the process that runs MACHINE go on, and pause them again.

    MACHINE may be omitted if one process runs all machines.

    \b
    llfsm step
    llfsm step Wall --until leave
    """
    with board.open(create=False) as wb:
        status = _debug(wb, _find(wb, machine), MachineRequest("step", until, lease_s))
        echo(f"paused in {status.state} ({status.paused})")


@click.command("continue")
@_machine
@board_option
def continue_(machine: str | None, board: BoardPlace) -> None:
    """Let all machines of the process that runs MACHINE go on.

    MACHINE may be omitted if one process runs all machines.

    \b
    llfsm continue
    """
    with board.open(create=False) as wb:
        status = _debug(wb, _find(wb, machine), MachineRequest("continue"))
        echo(f"running in {status.state}")


@click.command()
@click.argument("machine")
@click.argument("sensor")
@click.argument("message", required=False)
@click.option("--release", is_flag=True, help="End the override.")
@_lease_option("End the override after SECONDS seconds, unless it is renewed.")
@board_option
def override(
    machine: str,
    sensor: str,
    message: str | None,
    release: bool,
    lease_s: float,
    board: BoardPlace,
) -> None:
    """Let SENSOR of MACHINE read MESSAGE, in JSON, for a while or until the machine ends.

    Nothing is posted: others read what is in the slot. `null` stands for no message.

    \b
    llfsm override Wall pose '{"x": 9.5}'
    llfsm override Wall pose --release
    """
    if release is (message is not None):
        raise click.UsageError("give either a MESSAGE or --release")
    request = MachineRequest("release", sensor)
    if message is not None:
        request = MachineRequest("override", f"{sensor} {message}", lease_s)
    with board.open(create=False) as wb:
        remote = find_machine(wb, machine)
        _carry_out(remote, request, lambda status: True)
        if problem := fetch_why(wb, remote.name).problem:
            raise click.ClickException(problem)
        how = "released" if release else f"overridden until `--release`, or for {lease_s:g} s"
        echo(f"{machine}: {sensor} is {how}")


def _debug(board: Board, remote: RemoteMachine, request: MachineRequest) -> MachineStatus:
    """Have the machines of a process paused, stepped or continued; return the status then."""

    def is_done(status: MachineStatus) -> bool:
        return bool(status.paused) == (request.action != "continue")

    status = _carry_out(remote, request, is_done)
    for other in Directory(board).machines():  # their statuses are published one by one
        if identity(other.status) == identity(status):
            with suppress(click.ClickException):  # it may end: only the first one is asked for
                _await(other, request, is_done)
    return status


def _carry_out(
    remote: RemoteMachine, request: MachineRequest, is_done: Callable[[MachineStatus], bool]
) -> MachineStatus:
    with suppress(TimeoutError):
        for _ in remote.statuses(_BEFORE_S):
            remote = remote.again()
            if not remote.is_asked:  # else this request would replace one from elsewhere
                break
    remote.send(request)
    before = remote.status.obeyed
    return _await(remote, request, lambda status: status.obeyed > before and is_done(status))


def _await(
    remote: RemoteMachine, request: MachineRequest, is_done: Callable[[MachineStatus], bool]
) -> MachineStatus:
    try:
        for status in remote.statuses():
            if is_done(status):
                return status
    except TimeoutError as error:
        does = "it runs on until it does" if request.action == "step" else "see `llfsm ps`"
        if (silent_s := remote.again().silent_s) > SILENT_S:
            does = f"its process is silent for {silent_s:.0f} s; is it stopped?"
        raise click.ClickException(f"{remote.name} has not reached that {error}: {does}") from error
    raise click.ClickException(f"{remote.name} has ended in the meantime")


def _find(board: Board, name: str | None) -> RemoteMachine:
    if name is not None:
        return find_machine(board, name)
    machines = Directory(board).machines()
    first = {identity(machine.status): machine for machine in reversed(machines)}
    if len(first) == 1:
        return next(iter(first.values()))
    if not first:
        raise click.ClickException(f"no machine runs on {board.name}")
    names = ", ".join(machine.name for machine in first.values())
    raise click.UsageError(f"{len(first)} processes run machines: name one of {names}")
