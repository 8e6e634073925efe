"""``llfsm pause``, ``step`` and ``continue``, for all machines of a process, and ``override``."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from typing import Any, TypeVar, get_args

import click

from llfsm.runtime.debugging.debugger import Step
from llfsm.runtime.debugging.obeying import LEASE_S
from llfsm.runtime.presence.hosts import find_machine
from llfsm.runtime.presence.remote import SILENT_S, Directory, RemoteMachine, pause_text
from llfsm.whiteboard import Board
from llfsm.whiteboard.liveness import identity
from llfsm.whiteboard.messages.llfsm import MachineRequest, MachineStatus

from .numbers import Number
from .options import BoardPlace, board_option
from .why import fetch_why

__all__ = ["continue_", "override", "pause", "step"]

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
        click.echo(f"paused in {status.state} until `llfsm continue`")
        click.echo(pause_text(status))


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
        click.echo(f"paused in {status.state} ({status.paused})")


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
        click.echo(f"running in {status.state}")


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
        click.echo(f"{machine}: {sensor} is {how}")


def _debug(board: Board, remote: RemoteMachine, request: MachineRequest) -> MachineStatus:
    """Have the machines of a process paused, stepped or continued; return the status then.

    Raise ``click.ClickException`` if that takes more than a few seconds, or it ends instead.
    """

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
