"""``llfsm whiteboard``: list, read, write and remove whiteboards, and mirror one between hosts."""

from __future__ import annotations

import json
import logging
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import click
import msgspec

from llfsm.cli.console import log_to_console
from llfsm.cli.echo import echo
from llfsm.cli.options import BoardPlace, Integer, board_option, directory_option, file_option
from llfsm.errors import LlfsmError
from llfsm.runtime.engine.errors import ConfigurationError
from llfsm.runtime.engine.realtime import stop_on_signals
from llfsm.runtime.plans import line_of, read_text, read_toml
from llfsm.runtime.presence.guard import GuardThread
from llfsm.runtime.presence.hosts import (
    FleetTable,
    HostNames,
    HostRow,
    hearing,
    summary_publisher,
)
from llfsm.runtime.presence.remote import PATIENCE_S, SILENT_S
from llfsm.runtime.presence.slot_ownership import contested_slots, described
from llfsm.whiteboard import (
    BoardError,
    BoardNotFoundError,
    Message,
    Sample,
    Slot,
    SlotNotFoundError,
    Whiteboard,
)
from llfsm.whiteboard.board_files import remove_board
from llfsm.whiteboard.errors import NetworkError
from llfsm.whiteboard.message_text import message_class, parse_message
from llfsm.whiteboard.messages.llfsm import MIRROR, HostHeard, MirrorStatus
from llfsm.whiteboard.mirror.settings import DEFAULT_ENDPOINT, Settings
from llfsm.whiteboard.poller import BoardPoller
from llfsm.whiteboard.schema import to_plain
from llfsm.whiteboard.shared import boards

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
                echo(f"{slot.name}  {slot.info.type_name}  {status}")
            for name, commanders in contested_slots(wb).items():
                echo(described(name, commanders))
        return
    for found in boards(directory):
        echo(f"{found.name}  {'in use' if found.used else 'not in use'}")


_as_json = click.option(
    "--json",
    "as_json",
    is_flag=True,
    help="Print an object a line, for programs: NaN and infinities are null.",
)


@click.command()
@click.argument("slot")
@_as_json
@board_option
def get(slot: str, as_json: bool, board: BoardPlace) -> None:
    """Print the latest message of SLOT as JSON."""
    with board.open(create=False) as wb:
        message = wb.get_message(_find(wb, slot))
        if message is None:
            raise click.ClickException(f"nothing was added to {slot!r} yet")
        echo(_strict_json(to_plain(message)) if as_json else _json(message))


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
        echo(f"message {count} of {slot}")


@click.command()
@click.argument("slots", nargs=-1)
@click.option("-n", "--changes", type=Integer(1), help="Stop after this many messages.")
@_as_json
@board_option
def watch(slots: tuple[str, ...], changes: int | None, as_json: bool, board: BoardPlace) -> None:
    """Print the messages of SLOTS (default: all) as they are added, until Ctrl-C.

    If a slot changes more often than 50 times a second, only its newest message is printed.
    """
    with board.open(create=False) as wb:
        try:
            for number, (name, sample) in enumerate(_changes(wb, slots), 1):
                if as_json:
                    row = {"slot": name, "count": sample.count}
                    echo(_strict_json(row | {"message": to_plain(sample.message)}))
                else:
                    echo(f"{name} {sample.count} {_json(sample.message)}")
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
                echo(f"{slot.name} cannot be read: {slot.problem}", err=True)
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


def _strict_json(value: object) -> str:
    """Write JSON as other programs read it: without NaN and infinities, which become null."""
    return msgspec.json.encode(value).decode()


@click.command()
@board_option
@file_option("-c", "--config", help="Settings, in TOML.")
@click.option(
    "--listen",
    metavar="ENDPOINT",
    multiple=True,
    help=f"Where to listen for other hosts; by default {DEFAULT_ENDPOINT}.",
)
@click.option("--connect", metavar="ENDPOINT", multiple=True, help="Where another host listens.")
@click.option("--as", "as_", metavar="NAME", help="This host's name: others see its slots there.")
@click.option("--fleet", metavar="GLOB", multiple=True, help="Names of other hosts, for --as.")
@click.option("--multicast", is_flag=True, help="Look for other hosts by multicast.")
@click.option("--leave", metavar="GLOB", multiple=True, help="Publish only slots that match.")
@click.option("--enter", metavar="GLOB", multiple=True, help="Accept only slots that match.")
@click.option("--read-only", is_flag=True, help="Accept nothing from other hosts.")
@click.option(
    "--rate", type=float, help="Publish a slot at most this often a second; by default 100."
)
@click.option("--zenoh", metavar="FILE", help="Zenoh's own configuration: TLS, access control.")
def daemon(board: BoardPlace, config: Path | None, **flags: object) -> None:
    """Mirror a whiteboard between hosts: run one on each.

    It prints a line when it is ready. Options override the file.

    \b
    llfsm whiteboard daemon --listen tcp/0.0.0.0:7447
    llfsm whiteboard daemon --connect tcp/robot.local:7447 --enter 'robot/*'
    llfsm whiteboard daemon --as robot7 --fleet 'robot*'
    """
    from llfsm.whiteboard.mirror.daemon import daemon, status_publisher
    from llfsm.whiteboard.mirror.zenoh_internals import refusal_log

    settings = _settings(config, flags)
    log_to_console(logging.WARNING)
    with ExitStack() as stack:
        wb = stack.enter_context(board.opened())
        # Only Zenoh's own configuration brings certificates, which can be refused.
        log = None if settings.zenoh is None else stack.enter_context(refusal_log())
        try:
            mirror = stack.enter_context(daemon(wb, settings))
        except NetworkError as error:
            raise _located(error, config, flags) from error
        if log is not None:
            log.report = mirror.refuse
        with stop_on_signals(lambda _: mirror.stop()):
            where = ", ".join(mirror.listens) or "nowhere"
            stack.enter_context(GuardThread(*board))
            echo(f"mirroring {board.name}, listening on {where}")
            publish, summarize = status_publisher(wb), summary_publisher(wb)

            def report(status: MirrorStatus) -> None:
                publish(status)
                summarize(status)

            mirror.run(report)
        if not wb.alive:
            raise BoardNotFoundError(f"the whiteboard {board.name!r} was removed")


def _settings(config: Path | None, flags: dict[str, object]) -> Settings:
    settings = Settings() if config is None else read_toml(config, Settings)
    if config is not None and settings.zenoh is not None:
        beside = config.parent / settings.zenoh
        settings = msgspec.structs.replace(settings, zenoh=str(beside))
    if config is not None and settings.keep is not None:
        keep = msgspec.structs.replace(settings.keep, file=str(config.parent / settings.keep.file))
        settings = msgspec.structs.replace(settings, keep=keep)
    given = {
        name.removesuffix("_"): value
        for name, value in flags.items()
        if value is not None and value is not False and value != ()
    }
    try:
        return msgspec.convert({**msgspec.to_builtins(settings), **given}, Settings)
    except msgspec.ValidationError as error:
        what, _, place = str(error).partition(" - at `$.")
        raise click.UsageError(f"{place.rstrip('`')}: {what}" if place else what) from error


def _located(error: NetworkError, config: Path | None, flags: dict[str, object]) -> LlfsmError:
    """Name the line of the file that has the wrong setting, if it is there, in the error."""
    setting = error.setting
    if config is None or not setting or flags.get(str(setting[0])):
        return error
    line = line_of(read_text(config), setting)
    return ConfigurationError(str(error), setting, file=config, line=line)


@click.command()
@board_option
@click.option("--fleet", is_flag=True, help="Print which host hears which, and the lost ones.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def status(board: BoardPlace, fleet: bool, as_json: bool) -> None:
    """Print the status of a whiteboard's daemon: hosts, rates, lag, conflicts, refusals.

    With --fleet, it is a line for each named host, and a column for each that it hears: how long
    its messages take, or for how long it has been silent there; nothing if it was never heard.

    \b
    llfsm whiteboard status
    llfsm whiteboard status --fleet
    """
    latest = read_status(board)
    if fleet:
        if not latest.name:
            raise click.ClickException(
                "this host has no name in a fleet: start its daemon with --as and --fleet"
            )
        rows = _fleet_rows(board)
        echo(json.dumps(_heard_plain(rows)) if as_json else "\n".join(_heard_text(rows)))
        return
    echo(json.dumps(to_plain(latest)) if as_json else f"{board.name}: {latest.text()}")


def _fleet_rows(board: BoardPlace) -> list[HostRow]:
    """Wait until the hosts that can be reached have sent a summary, for a few seconds at most."""
    with board.open(create=False) as wb, FleetTable(wb) as table:
        begin = time.monotonic()
        while True:
            table.look()
            rows = table.rows()
            waited_s = time.monotonic() - begin
            reached = [row for row in rows if row.is_there]
            is_new = [row.contact_ns and row.contact_ns > begin * 1e9 for row in reached]
            if waited_s > PATIENCE_S or (waited_s > 1 and len(reached) > 1 and all(is_new)):
                return rows
            time.sleep(_POLL_S)


def _lost_s(row: HostRow) -> float | None:
    if row.trouble != "lost" or row.contact_ns is None:
        return None
    return (time.monotonic_ns() - row.contact_ns) / 1e9


def _heard_plain(rows: list[HostRow]) -> dict[str, Any]:
    heard = hearing(rows)
    return {
        row.name: {
            "lost": row.trouble == "lost",
            "lost_s": _lost_s(row),
            "hears": {name: to_plain(each) for name, each in heard.get(row.name, {}).items()},
        }
        for row in rows
    }


def _heard_text(rows: list[HostRow]) -> Iterator[str]:
    heard = hearing(rows)
    names = [row.name for row in rows]
    columns = dict.fromkeys((*names, *(name for each in heard.values() for name in each)))
    lines = [["HOST", *columns, ""]]
    for row in rows:
        of_row, lost_s = heard.get(row.name, {}), _lost_s(row)
        cells = ["." if name == row.name else _cell(of_row.get(name)) for name in columns]
        state = "" if row.trouble != "lost" else "lost"
        lines.append([row.name, *cells, state if lost_s is None else f"lost for {lost_s:.0f} s"])
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    for line in lines:
        cells = [cell.ljust(width) for cell, width in zip(line, widths, strict=True)]
        yield "  ".join(cells).rstrip()


def _cell(heard: HostHeard | None) -> str:
    if heard is None:
        return "-"
    if heard.silent_s > SILENT_S:
        return f"silent {heard.silent_s:.0f} s"
    return f"{heard.lag_ms:.1f} ms"


def read_status(board: BoardPlace, *, stale_s: float = 3.0) -> MirrorStatus:
    """Return the status that a board's daemon has published in the last `stale_s` seconds."""
    with board.open(create=False) as wb:
        sample = wb[MIRROR].sample() if MIRROR.name in {i.name for i in wb.slots()} else None
    if sample is None:
        raise click.ClickException(
            f"no daemon mirrors the whiteboard {board.name!r}; start `llfsm whiteboard daemon`"
        )
    silent_s = (time.monotonic_ns() - sample.stamp_ns) / 1e9
    if silent_s > stale_s:
        raise click.ClickException(
            f"the daemon of {board.name!r}, process {sample.writer}, has ended or is stopped: "
            f"it has published no status for {silent_s:.1f} s"
        )
    return sample.message
