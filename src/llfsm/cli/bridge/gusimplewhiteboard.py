"""``llfsm bridge gusimplewhiteboard``: slots relayed to and from a gusimplewhiteboard."""

from __future__ import annotations

import logging
from contextlib import closing
from pathlib import Path
from typing import get_args

import click
import msgspec

from llfsm.bridges.gusimplewhiteboard.file import DEFAULT_PATH, GuWhiteboard
from llfsm.bridges.gusimplewhiteboard.relay import (
    ConfiguredRelay,
    Direction,
    Relay,
    RelayConfiguration,
    check_configuration,
    read_configuration,
    run,
)
from llfsm.cli.console import log_to_console
from llfsm.cli.echo import echo
from llfsm.cli.options import BoardPlace, Integer, Number, directory_option
from llfsm.runtime.engine.errors import ConfigurationError
from llfsm.runtime.engine.realtime import StopRequest, stop_on_signals
from llfsm.runtime.presence.guard import GuardThread
from llfsm.whiteboard.board_files import default_name

_Relays = tuple[tuple[int, str, str, str], ...]
_RELAY = (Integer(0, 511), str, str, str)
_METAVAR = "NUMBER SLOT TYPE LAYOUT"


@click.command()
@click.argument(
    "config_file",
    metavar="[FILE.toml]",
    required=False,
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
)
@click.option("--in", "in_", type=_RELAY, metavar=_METAVAR, multiple=True, help="Relay to SLOT.")
@click.option("--out", type=_RELAY, metavar=_METAVAR, multiple=True, help="Relay from SLOT.")
@click.option("--both", type=_RELAY, metavar=_METAVAR, multiple=True, help="Relay both ways.")
@click.option("--file", metavar="PATH", help=f"The gusimplewhiteboard; by default {DEFAULT_PATH}.")
@click.option(
    "-b",
    "--board",
    metavar="NAME",
    help="The whiteboard; by default the file's, $WHITEBOARD_NAME, or `whiteboard`.",
)
@directory_option
@click.option(
    "--period-ms",
    type=Number(0, min_open=True),
    metavar="MS",
    help="The period of polling; by default 5.",
)
def gusimplewhiteboard(
    config_file: Path | None,
    in_: _Relays,
    out: _Relays,
    both: _Relays,
    directory: str,
    **given: str | float | None,
) -> None:
    """Relay slots to and from a gusimplewhiteboard of version 2207, until Ctrl-C.

    NUMBER is the gusimplewhiteboard's number of the message, TYPE as for `llfsm whiteboard add`,
    LAYOUT a format of Python's struct or module:Structure, a ctypes structure with the message's
    field names.

    \b
    llfsm bridge gusimplewhiteboard --in 12 turtle1/cmd_vel geometry_msgs/Twist 6d
    llfsm bridge gusimplewhiteboard robot.toml
    """
    log_to_console(logging.INFO)
    config = RelayConfiguration() if config_file is None else read_configuration(config_file)
    relays = [
        ConfiguredRelay(number=number, slot=slot, type=kind, layout=layout, direction=direction)
        for direction, listed in zip(get_args(Direction), (in_, out, both), strict=True)
        for number, slot, kind, layout in listed
    ]
    known = {name: value for name, value in given.items() if value is not None}
    config = msgspec.structs.replace(config, relays=(*config.relays, *relays), **known)
    if not config.relays:
        raise click.UsageError("nothing to relay: a [[relay]] in FILE.toml, or --in, --out, --both")
    try:
        check_configuration(config)
    except ConfigurationError as error:
        raise click.UsageError(str(error)) from error
    _relay(config, BoardPlace(config.board or default_name(), directory))


def _relay(config: RelayConfiguration, place: BoardPlace) -> None:
    asked, period_s = StopRequest(), config.period_ms / 1000
    with (
        closing(GuWhiteboard(config.file)) as foreign,
        place.open() as board,
        GuardThread(*place),
    ):
        relays = [
            Relay(foreign, configured.number, board, *configured.resolve(), configured.direction)
            for configured in config.relays
        ]
        echo(f"{config.file} <-> {board.name}: {len(relays)} relayed", err=True)
        try:
            with stop_on_signals(lambda _: asked.make()):
                run(foreign, relays, lambda: asked.wait(period_s), lambda: board.alive)
        finally:
            for relay in relays:
                echo(
                    f"{relay}: {relay.relayed_in} in, {relay.relayed_out} out, "
                    f"{relay.refused} refused",
                    err=True,
                )
