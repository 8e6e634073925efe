"""Machines of which all is recorded: by a process of their own, or by whoever records the board.

Machines share neither a core nor a fate with a recorder: they hand their journal over on the
whiteboard and never wait. If it dies they go on; if they are killed it completes its file.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click

from llfsm.runtime.engine.arrangement import Arrangement
from llfsm.runtime.engine.failure import logger
from llfsm.runtime.journal.handover import Handover, find_recorder
from llfsm.runtime.journal.journalled import JournalledArrangement
from llfsm.runtime.plans.plan import Plan
from llfsm.whiteboard import Whiteboard, WhiteboardError

__all__ = ["recorded"]

_PATIENCE_S = 5.0  # for the file to be completed


@contextmanager
def recorded(
    file: Path | None, board: Whiteboard, plan: Plan, *, forks: bool = False
) -> Iterator[Callable[..., Arrangement]]:
    """Give what makes an arrangement of which all is recorded, if anybody records the board.

    With `file`, a recorder that makes it is started, and ends with the ``with`` block. Of one that
    `forks` the events alone are recorded, from when it runs. Raise ``click.ClickException`` if
    that cannot be.
    """
    recorder = find_recorder(board)
    if file is not None:
        if recorder is not None:
            raise click.ClickException(
                f"process {recorder.pid} records the machines of {board.name!r} already: "
                f"end it, or leave out --record; nothing was run"
            )
        with _recorder(file, board):
            yield _made_for(board, plan)
        return
    make: Callable[..., Arrangement] = Arrangement
    if recorder is not None and not forks:
        try:
            make = _made_for(board, plan)
        except WhiteboardError as error:  # what somebody else records is no reason not to run
            logger().warning("the machines go on unrecorded: %s", error)
    yield make


def _made_for(board: Whiteboard, plan: Plan) -> Callable[..., Arrangement]:
    recorder = find_recorder(board)
    if recorder is None:
        raise click.ClickException("the recorder does not record machines, nothing was run")
    handover = Handover(board, recorder, whole=True)
    handover.journal.add(("Plan", plan, str(Path.cwd())))

    def make(**options: Any) -> Arrangement:
        arrangement = JournalledArrangement(journal=handover.journal, **options)
        arrangement.handover = handover
        return arrangement

    return make


@contextmanager
def _recorder(file: Path, board: Whiteboard) -> Iterator[None]:
    """Have a process record the board; it ends when it cannot read what we write any more."""
    process = subprocess.Popen(
        [
            *(sys.executable, "-m", "llfsm.cli", "record", "--until-eof"),
            *("-o", str(file), "-b", board.name),
        ],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        start_new_session=True,  # a Ctrl-C is for the machines, whose last events it must see
    )
    assert process.stdin is not None
    assert process.stdout is not None
    try:
        with process.stdout as said:
            if not said.readline():
                raise click.ClickException("the recorder did not start, nothing was run")
        yield
    finally:
        process.stdin.close()
        try:
            process.wait(_PATIENCE_S)
        except subprocess.TimeoutExpired:
            process.kill()  # what it has written can be read
            process.wait()
