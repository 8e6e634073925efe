"""``llfsm view``: a whiteboard and its machines, live, on a page in the browser."""

from __future__ import annotations

import ipaddress
import logging
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import TYPE_CHECKING

import click

from llfsm.bridges.view.page_source import PageSource
from llfsm.runtime.presence.guard import GuardThread

from .options import (
    BoardPlace,
    board_option,
    checked_host,
    end_with_input,
    topics_option,
    trust_option,
    until_eof_option,
)
from .page import page_options, serve

if TYPE_CHECKING:
    from starlette.types import ASGIApp

    from llfsm.bridges.recording.explaining import Explainer

__all__ = ["view"]


@click.command()
@click.argument("recording", required=False, type=click.Path(path_type=Path))
@click.argument("machines", nargs=-1)
@board_option
@topics_option
@click.option(
    "--host",
    metavar="NAME",
    default="",
    callback=lambda _, __, value: _host(value),
    help="Show only this host of the fleet.",
)
@click.option("--fleet", is_flag=True, help="Show a table of all hosts, with a page for each.")
@page_options
@click.option("--control", is_flag=True, help="Let the page control machines and post messages.")
@trust_option
@until_eof_option
def view(
    recording: Path | None,
    machines: tuple[str, ...],
    board: BoardPlace,
    config: Path | None,
    host: str,
    fleet: bool,
    address: str,
    port: int,
    no_open: bool,
    control: bool,
    trust: bool,
    until_eof: bool,
) -> None:
    """Show a whiteboard and its machines on a page in the browser, until Ctrl-C.

    The whiteboard may be created later, removed and created again. RECORDING, a file of `llfsm
    record` or a rosbag2 bag, is shown instead of a whiteboard, with a slider over its time.
    MACHINES, named as for llfsm rerun, run again, and the page shows what guards saw at any time.
    It needs the token in the printed address: $LLFSM_VIEW_TOKEN, or else a new one.

    \b
    llfsm view -b demo
    llfsm view -b demo --control
    llfsm view --host robot7
    llfsm view --fleet
    llfsm view run.mcap
    llfsm view run.mcap --trust
    """
    if until_eof:
        end_with_input()
    if recording is None and trust:
        raise click.UsageError("--trust is for a recording")
    if recording is not None and (host or fleet):
        option = "--host" if host else "--fleet"
        raise click.UsageError(f"{option} is for a whiteboard; leave it out for a recording")
    if host and fleet:
        raise click.UsageError("--fleet has a page for each host; leave out --host")
    if recording is not None and not recording.exists() and ":" in recording.name:
        raise click.UsageError(
            f"{recording} is not a recording, which comes first; `llfsm edit {recording}` shows a "
            f"machine, and without a recording the page shows the live ones of a whiteboard"
        )
    source = None
    if not fleet:
        source = _source(recording, machines, board, config, host=host, trust=trust)
    with ExitStack() as stack:
        if recording is None:
            stack.enter_context(GuardThread(*board))

        def make(token: str) -> ASGIApp:
            if source is None:
                from llfsm.bridges.view.fleet_app import make_fleet_app

                return make_fleet_app(*board, host=address, token=token, control=control)
            from llfsm.bridges.view.app import make_app

            return make_app(source, host=address, token=token, control=control)

        what = f"{board.name}, fleet" if source is None else source.title
        serve(make, f"llfsm view: {what}", host=address, port=port, open_page=not no_open)


def _host(value: str) -> str:
    """Return the name of a host; raise ``click.BadParameter`` for what cannot be one here."""
    with suppress(ValueError):
        ipaddress.ip_address("127.0.0.1" if value == "localhost" else value)
        raise click.BadParameter(f"it names a host of the fleet; to listen, use --address {value}")
    return checked_host(value)


def _source(
    recording: Path | None,
    machines: tuple[str, ...],
    board: BoardPlace,
    config: Path | None,
    *,
    host: str,
    trust: bool,
) -> PageSource:
    if recording is None:
        from llfsm.bridges.view.live_source import LiveSource

        return LiveSource(*board, host=host)
    from llfsm.bridges.recording.bags import BagTopics
    from llfsm.bridges.recording.recorded_source import RecordedSource

    from .bridge.configured import Configured

    topics = BagTopics(Configured.read(config).config)
    explainer = _explainer(recording, machines, trust=trust) if machines or trust else None
    return RecordedSource(recording, topics=topics, explainer=explainer)


def _explainer(file: Path, machines: tuple[str, ...], *, trust: bool) -> Explainer:
    from llfsm.bridges.recording.explaining import Explained, Explainer
    from llfsm.bridges.recording.reader import Recording

    from .recorded_plans import plan_of_one, travel_through

    # Late turns and failures were reported at the time of the recording.
    logging.getLogger("llfsm.runtime").setLevel(logging.CRITICAL)
    recording = Recording(file)
    journal, resolved = plan_of_one(recording, machines, trust=trust)
    # Its processes are forked from this one, before that has threads and connections.
    travel = travel_through(recording, journal, resolved, Explained)
    return Explainer(journal.process, travel)
