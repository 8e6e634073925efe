"""``llfsm dap``: an adapter of the Debug Adapter Protocol, on standard input and output."""

from __future__ import annotations

import io
import logging
import os
import sys
from contextlib import redirect_stdout, suppress

import click

from llfsm.cli.dap.adapter import Adapter
from llfsm.cli.dap.framing import MessageStream


@click.command()
def dap() -> None:
    """Let an editor debug machines, by the Debug Adapter Protocol on standard input and output.

    An editor starts this; how-to/debugging.md shows how to set it up.

    \b
    llfsm dap
    """
    # What code prints must not get among the messages, nor what it reads take any from them; and
    # neither what programs do that it starts.
    with (
        suppress(BrokenPipeError),
        os.fdopen(os.dup(0), "rb") as received,
        os.fdopen(os.dup(1), "wb") as sent,
        open(os.devnull) as nothing,
    ):
        os.dup2(nothing.fileno(), 0)
        os.dup2(2, 1)
        adapter = Adapter(MessageStream(received, sent))
        sys.stdin, sys.breakpointhook = nothing, adapter.break_in_code
        logging.basicConfig(level=logging.INFO, format="%(message)s", handlers=[_Log(adapter)])
        with redirect_stdout(_Printed(adapter)):
            adapter.serve()


class _Printed(io.TextIOBase):
    """Standard output, as an editor shows it."""

    def __init__(self, adapter: Adapter):
        self._adapter = adapter

    def write(self, text: str) -> int:
        """Show a text."""
        self._adapter.print("stdout", text)
        return len(text)


class _Log(logging.Handler):
    """What is logged, as an editor shows it."""

    def __init__(self, adapter: Adapter):
        super().__init__()
        self._adapter = adapter

    def emit(self, record: logging.LogRecord) -> None:
        """Show a record."""
        category = "stdout" if record.levelno < logging.WARNING else "stderr"
        self._adapter.print(category, f"{self.format(record)}\n")
