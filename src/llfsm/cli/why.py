"""``llfsm why``: the transitions of a machine's state, with the values that their guards see."""

from __future__ import annotations

import os
import time
from collections.abc import Iterable, Iterator

import click

from llfsm.runtime.debugging.causes import NOT_EVALUATED
from llfsm.runtime.presence.hosts import HostNames, find_machine
from llfsm.runtime.presence.remote import PATIENCE_S
from llfsm.whiteboard import Board
from llfsm.whiteboard.messages.debugging import MachineWhy, SeenTransition, why_slot
from llfsm.whiteboard.messages.llfsm import Viewer

from .options import BoardPlace, board_option

__all__ = ["cause_value", "fetch_why", "why", "why_lines"]


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
            click.echo(line)
        if found.status.failed:
            click.echo(f"it has failed: {found.status.error}")


def fetch_why(board: Board, machine: str) -> MachineWhy:
    """Have a machine publish why it is in its state; raise ``click.ClickException`` if not soon."""
    slot, until = board[why_slot(machine)], time.monotonic() + PATIENCE_S
    names, before = HostNames(board), slot.count
    while time.monotonic() < until:
        names.ask(board, names.of_machine(machine), Viewer(os.getpid(), why=True))
        found = slot.wait(after=before, timeout=0.25)
        if found is not None:
            return found.message
    raise click.ClickException(f"{machine} does not answer; see `llfsm ps`")


def why_lines(why: MachineWhy) -> Iterator[str]:
    """Yield what is printed of a machine."""
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
    """Return how the value of a transition is shown."""
    if value is None:
        return "-" if seen == NOT_EVALUATED else "?"
    return "true" if value else "false"
