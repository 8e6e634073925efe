"""``llfsm guard``: execute the last wills of machines whose processes died."""

from __future__ import annotations

import logging

import click

from llfsm.cli.console import log_to_console
from llfsm.cli.options import BoardPlace, board_option, end_with_input, until_eof_option
from llfsm.runtime.engine.realtime import StopRequest, stop_on_signals
from llfsm.runtime.presence.guard import GuardThread


@click.command()
@board_option
@until_eof_option
def guard(board: BoardPlace) -> None:
    """Post the safe values of machines whose processes die without shutting down, until Ctrl-C.

    Bridges, `llfsm whiteboard daemon` and `llfsm view` do so, too. One guard is enough; of several,
    only one posts. The whiteboard may be created later, removed and created again.

    \b
    llfsm guard -b robot
    """
    log_to_console(logging.INFO)
    logging.getLogger("llfsm.guard").setLevel(logging.DEBUG)  # which whiteboard is guarded, too
    asked = StopRequest()
    with stop_on_signals(lambda _: asked.make()), GuardThread(*board):
        end_with_input()
        asked.wait()
