"""``llfsm whiteboard list``, ``get``, ``add``, ``watch`` and ``rm``."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from typing import Any

import click

from llfsm.runtime.presence.commanders import contested_slots, described
from llfsm.runtime.presence.hosts import HostNames
from llfsm.whiteboard import BoardError, Message, Sample, Slot, SlotNotFoundError, Whiteboard
from llfsm.whiteboard.board_files import remove_board
from llfsm.whiteboard.message_text import message_class, parse_message
from llfsm.whiteboard.poller import BoardPoller
from llfsm.whiteboard.schema import to_plain
from llfsm.whiteboard.shared import boards

from ..numbers import Integer
from ..options import BoardPlace, board_option, directory_option

__all__ = ["add", "get", "list_", "rm", "watch"]

_POLL_S = 0.02  # how often `watch` polls: a frame of a screen


@click.command("list")
@click.argument("board", required=False)
@click.option("-b", "--board", "named", metavar="NAME", help="BOARD, as other commands take it.")
@directory_option
def list_(board: str | None, named: str | None, directory: str) -> None:
    """List the whiteboards of this host, or the slots of one BOARD."""
    if board is not None and named is not None:
        raise click.UsageError(f"two whiteboards are named, {board!r} and {named!r}; name one")
    board = board or named
    if board is not None:
        with Whiteboard(board, directory=directory, create=False) as wb:
            poller = BoardPoller(wb)
            poller.poll()
            for slot in poller.slots.values():
                status = f"cannot be read: {slot.problem}" if slot.problem else _age(slot.sample)
                click.echo(f"{slot.name}  {slot.info.type_name}  {status}")
            for name, commanders in contested_slots(wb).items():
                click.echo(described(name, commanders))
        return
    for found in boards(directory):
        click.echo(f"{found.name}  {'in use' if found.used else 'not in use'}")


@click.command()
@click.argument("slot")
@board_option
def get(slot: str, board: BoardPlace) -> None:
    """Print the latest message of SLOT as JSON."""
    with board.open(create=False) as wb:
        message = wb.get_message(_find(wb, slot))
        if message is None:
            raise click.ClickException(f"nothing was added to {slot!r} yet")
        click.echo(_json(message))


@click.command()
@click.argument("slot")
@click.argument("message")
@click.option(
    "--type",
    "kind",
    metavar="TYPE",
    help="For a new slot: package.module:Class, or a shipped type, such as geometry_msgs/Twist.",
)
@board_option
def add(slot: str, message: str, kind: str | None, board: BoardPlace) -> None:
    """Add MESSAGE, a JSON object, to SLOT; omitted fields are zero. A new slot needs --type."""
    with board.open(create=kind is not None) as wb:
        try:
            target = wb.find(slot) if kind is None else Slot(slot, message_class(kind))
        except SlotNotFoundError as error:
            raise click.ClickException(f"{error}; a new slot needs --type") from error
        count = wb.add_message(target, parse_message(target, message))
        click.echo(f"message {count} of {slot}")


@click.command()
@click.argument("slots", nargs=-1)
@click.option("-n", "--changes", type=Integer(1), help="Stop after this many messages.")
@board_option
def watch(slots: tuple[str, ...], changes: int | None, board: BoardPlace) -> None:
    """Print the messages of SLOTS (default: all) as they are added, until Ctrl-C.

    If a slot changes more often than 50 times a second, only its newest message is printed.
    """
    with board.open(create=False) as wb:
        try:
            for number, (name, sample) in enumerate(_changes(wb, slots), 1):
                click.echo(f"{name} {sample.count} {_json(sample.message)}")
                if number == changes:
                    return
        except KeyboardInterrupt:
            return
    raise click.ClickException(f"the whiteboard {board.name!r} was removed")


def _changes(wb: Whiteboard, names: tuple[str, ...]) -> Iterator[tuple[str, Sample[Message]]]:
    for name in names:
        _find(wb, name)
    poller = BoardPoller(wb, wants=frozenset(names).__contains__ if names else None)
    unreadable: set[str] = set()
    while wb.alive:
        for slot in poller.poll():
            if slot.sample is not None:
                yield slot.name, slot.sample
            elif slot.name not in unreadable:
                unreadable.add(slot.name)
                click.echo(f"{slot.name} cannot be read: {slot.problem}", err=True)
        time.sleep(_POLL_S)


@click.command()
@click.argument("names", metavar="BOARD...", nargs=-1, required=True)
@directory_option
@click.option("-f", "--force", is_flag=True, help="Remove them even if a process has them open.")
def rm(names: tuple[str, ...], force: bool, directory: str) -> None:
    """Remove whiteboards; processes that have one open stop."""
    used = {info.name for info in boards(directory) if info.used}
    for name in names:
        if name in used and not force:
            raise BoardError(
                f"the whiteboard {name!r} is in use; end its processes, or use --force"
            )
        remove_board(name, directory)


def _find(wb: Whiteboard, name: str) -> Slot[Any]:
    try:
        return wb.find(name)
    except SlotNotFoundError as error:
        names = HostNames(wb)
        host = names.of_slot(name)
        if host in ("", names.own) or not names.is_mirrored:
            raise
        why = f"of host {host}, only what is read here arrives: see `llfsm top --host {host}`"
        raise click.ClickException(f"{error}; {why}") from error


def _age(sample: Sample[Any] | None) -> str:
    if sample is None:
        return "nothing added yet"
    seconds = (time.monotonic_ns() - sample.stamp_ns) / 1e9
    return f"{sample.count} added, the last {seconds:.1f} s ago by process {sample.writer}"


def _json(message: Message) -> str:
    return json.dumps(to_plain(message), ensure_ascii=False)
