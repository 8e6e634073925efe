"""What a command does for the process that supervises it."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable
from typing import Any

import click

__all__ = ["end_with_input", "supervised_options", "until_eof_option"]


def until_eof_option(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the option of a command that another program may start and watch."""
    return click.option(
        "--until-eof", is_flag=True, help="End when standard input is closed, as by a supervisor."
    )(command)


def supervised_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options of such a command that has a whiteboard."""
    return click.option(
        "--remove-board", is_flag=True, help="Remove the whiteboard at the end, however it comes."
    )(until_eof_option(command))


def end_with_input() -> None:
    """Ask this process to end, as SIGTERM does, when its standard input is closed.

    A supervisor that holds the other end of a pipe thereby takes its processes with it even if
    it is killed.
    """

    def wait() -> None:
        while os.read(0, 4096):
            pass
        os.kill(os.getpid(), signal.SIGTERM)

    threading.Thread(target=wait, name="until-eof", daemon=True).start()
