"""``llfsm whiteboard daemon`` and ``status``: one whiteboard on several hosts."""

from __future__ import annotations

import json
import logging
import time
from contextlib import ExitStack
from pathlib import Path

import click
import msgspec

from llfsm.errors import LlfsmError
from llfsm.runtime.engine.errors import ConfigurationError
from llfsm.runtime.engine.signals import stop_on_signals
from llfsm.runtime.plans.toml_files import line_of, read_text, read_toml
from llfsm.runtime.presence.guard import GuardThread
from llfsm.runtime.presence.summary import summary_publisher
from llfsm.whiteboard import BoardNotFoundError
from llfsm.whiteboard.errors import NetworkError
from llfsm.whiteboard.messages.llfsm import MIRROR, MirrorStatus
from llfsm.whiteboard.mirror.settings import DEFAULT_ENDPOINT, Settings
from llfsm.whiteboard.schema import to_plain

from ..console import log_to_console
from ..options import BoardPlace, board_option

__all__ = ["daemon", "read_status", "status"]


@click.command()
@board_option
@click.option(
    "-c", "--config", metavar="FILE", type=click.Path(path_type=Path), help="Settings, in TOML."
)
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
            click.echo(f"mirroring {board.name}, listening on {where}")
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
    """Return the error with the place in the file where the wrong setting is, if it is there."""
    setting = error.setting
    if config is None or not setting or flags.get(str(setting[0])):
        return error
    line = line_of(read_text(config), setting)
    return ConfigurationError(str(error), setting, file=config, line=line)


@click.command()
@board_option
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def status(board: BoardPlace, as_json: bool) -> None:
    """Print the status of a whiteboard's daemon: hosts, rates, lag, conflicts, refusals."""
    latest = read_status(board)
    click.echo(json.dumps(to_plain(latest)) if as_json else _text(board.name, latest))


def read_status(board: BoardPlace, *, stale_s: float = 3.0) -> MirrorStatus:
    """Return the status that a board's daemon has published.

    Raise ``click.ClickException`` if there is no daemon, or if its status is older than `stale_s`
    seconds.
    """
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


def _text(board: str, latest: MirrorStatus) -> str:
    lines = [
        f"{board}: mirrored by process {latest.pid}, host {latest.host}"
        + (f", as {latest.name}" if latest.name else ""),
        f"slots      {latest.slots} may leave",
        f"left       {latest.left}, {latest.leave_rate:g} a second",
        f"entered    {latest.entered}, {latest.enter_rate:g} a second",
        f"traffic    {latest.sent_rate / 1000:.1f} kB/s out, {latest.received_rate / 1000:.1f} in",
        f"conflicts  {latest.conflicts}",
        f"held back  {latest.held_back}",
    ]
    for peer in latest.peers:
        last = f", the last {peer.silent_s:.1f} s ago" if peer.silent_s > 1 else ""
        certified = f", certificate {peer.certificate}" if peer.certificate else ""
        lines.append(
            f"peer       {peer.host} {peer.name}{certified}: lag {peer.lag_ms:.1f} ms, "
            f"{peer.received} batches{last}, {peer.lost} lost"
        )
    for quota in latest.quotas:
        lines.append(
            f"quota      {quota.name or 'other hosts'}: {quota.slots} of {quota.max_slots} slots, "
            f"{quota.bytes >> 20} of {quota.max_bytes >> 20} MiB, {quota.over_rate} over the rate"
        )
    lines += [f"refused    {refusal.count} x {refusal.what}" for refusal in latest.refused]
    return "\n".join(lines)
