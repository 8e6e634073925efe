"""``llfsm whiteboard daemon`` and ``status``: a whiteboard on several hosts."""

from __future__ import annotations

import json
import logging
import time
from contextlib import ExitStack
from pathlib import Path

import click
import msgspec

from llfsm.runtime.engine.signals import stop_on_signals
from llfsm.runtime.plans.toml_files import read_toml
from llfsm.whiteboard import BoardNotFoundError, Whiteboard
from llfsm.whiteboard.messages.llfsm import MIRROR, MirrorStatus
from llfsm.whiteboard.mirror.settings import DEFAULT_ENDPOINT, Settings
from llfsm.whiteboard.schema import to_plain

from .options import board_option, directory_option

__all__ = ["daemon", "status"]

_STALE_S = 3.0


@click.command()
@board_option
@directory_option
@click.option(
    "-c", "--config", metavar="FILE", type=click.Path(path_type=Path), help="Settings, in TOML."
)
@click.option(
    "--listen",
    metavar="ENDPOINT",
    multiple=True,
    help=f"Where others reach this host; by default {DEFAULT_ENDPOINT}.",
)
@click.option("--connect", metavar="ENDPOINT", multiple=True, help="Where another host listens.")
@click.option("--multicast", is_flag=True, help="Look for other hosts by multicast.")
@click.option("--leave", metavar="GLOB", multiple=True, help="Only such slots leave.")
@click.option("--enter", metavar="GLOB", multiple=True, help="Only such slots enter.")
@click.option("--read-only", is_flag=True, help="Nothing enters: others may only read this board.")
@click.option("--rate", type=float, help="How often a slot leaves, a second; 100.")
@click.option("--zenoh", metavar="FILE", help="Zenoh's own configuration: TLS, access control.")
def daemon(board: str, directory: str, config: Path | None, **flags: object) -> None:
    """Mirror a whiteboard between hosts: run one on each.

    It is ready when it says so. Flags count more than what the file says.

    \b
    llfsm whiteboard daemon --listen tcp/0.0.0.0:7447
    llfsm whiteboard daemon --connect tcp/robot.local:7447 --enter 'robot/*'
    """
    from llfsm.whiteboard.mirror.complaints import complaints
    from llfsm.whiteboard.mirror.daemon import daemon, teller

    settings = _settings(config, flags)
    logging.basicConfig(format="%(message)s", level=logging.WARNING)
    with ExitStack() as stack:
        wb = stack.enter_context(Whiteboard(board, directory=directory))
        # Without a file there are no certificates.
        refused = None if settings.zenoh is None else stack.enter_context(complaints())
        mirror = stack.enter_context(daemon(wb, settings))
        if refused is not None:
            refused.hear = mirror.refuse
        with stop_on_signals(lambda _: mirror.stop()):
            where = ", ".join(mirror.listens) or "nowhere"
            click.echo(f"mirroring {board}, listening on {where}")
            mirror.run(teller(wb))
        if not wb.alive:
            raise BoardNotFoundError(f"the whiteboard {board!r} was removed")


def _settings(config: Path | None, flags: dict[str, object]) -> Settings:
    settings = Settings() if config is None else read_toml(config, Settings)
    if config is not None and settings.zenoh is not None:
        beside = config.parent / settings.zenoh
        settings = msgspec.structs.replace(settings, zenoh=str(beside))
    given = {name: value for name, value in flags.items() if value}
    try:
        return msgspec.convert({**msgspec.structs.asdict(settings), **given}, Settings)
    except msgspec.ValidationError as error:
        raise click.UsageError(str(error)) from error


@click.command()
@board_option
@directory_option
@click.option("--json", "as_json", is_flag=True, help="As one JSON object.")
def status(board: str, directory: str, as_json: bool) -> None:
    """Tell how the daemon of a whiteboard is: hosts, rates, lag, conflicts, refusals."""
    with Whiteboard(board, directory=directory, create=False) as wb:
        sample = wb[MIRROR].sample() if MIRROR.name in {i.name for i in wb.slots()} else None
    if sample is None:
        raise click.ClickException(
            f"no daemon mirrors the whiteboard {board!r}; start `llfsm whiteboard daemon`"
        )
    silent_s = (time.monotonic_ns() - sample.stamp_ns) / 1e9
    if silent_s > _STALE_S:
        raise click.ClickException(
            f"the daemon of {board!r}, process {sample.writer}, has ended or stands still: "
            f"it has told nothing for {silent_s:.1f} s"
        )
    if as_json:
        click.echo(json.dumps(to_plain(sample.message)))
    else:
        click.echo(_text(board, sample.message))


def _text(board: str, told: MirrorStatus) -> str:
    lines = [
        f"{board}: mirrored by process {told.pid}, host {told.host}",
        f"slots      {told.slots} may leave",
        f"left       {told.left}, {told.leave_rate:g} a second",
        f"entered    {told.entered}, {told.enter_rate:g} a second",
        f"conflicts  {told.conflicts}",
        f"held back  {told.held_back}",
    ]
    for peer in told.peers:
        silent = f", silent for {peer.silent_s:.1f} s" if peer.silent_s > 1 else ""
        lines.append(
            f"peer       {peer.host} {peer.name}: lag {peer.lag_ms:.1f} ms, "
            f"{peer.received} batches, {peer.lost} lost{silent}"
        )
    lines += [f"refused    {refusal.count} x {refusal.what}" for refusal in told.refused]
    return "\n".join(lines)
