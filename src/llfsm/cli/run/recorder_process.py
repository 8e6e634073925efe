"""The recorder of ``llfsm run --record``, a process of its own, and one that runs already.

Machines hand their journal to the recorder through the whiteboard and never wait for it. If the
recorder dies, they go on; if they are killed, it completes its file.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TypeAlias

import click

from llfsm.runtime.engine.clock import Clock
from llfsm.runtime.engine.environment import Environment
from llfsm.runtime.engine.failure import logger
from llfsm.runtime.journal.handover import HANDOVER_LIMIT, Handover, find_recorder
from llfsm.runtime.journal.journalled import JournalledEnvironment
from llfsm.runtime.plans.plan import Plan
from llfsm.runtime.presence.live import LiveEnvironment
from llfsm.whiteboard import Whiteboard, WhiteboardError
from llfsm.whiteboard.liveness import process_text

from ..options import BoardPlace

__all__ = ["MakeEnvironment", "recorded"]

MakeEnvironment: TypeAlias = Callable[..., LiveEnvironment]


@contextmanager
def recorded(
    file: Path | None,
    board: Whiteboard,
    plan: Plan,
    clock: Clock | None = None,
    live: MakeEnvironment = LiveEnvironment,
    *,
    forks: bool = False,
    limit: int = HANDOVER_LIMIT,
    patience_s: float = 5.0,
) -> Iterator[Environment]:
    """Give the environment of an arrangement on `board`, journalled if a process records the board.

    `live` makes it from the board, the clock and the options of `LiveEnvironment`.

    With `file`, a recorder that writes it is started; it ends with the ``with`` block. If the
    arrangement `forks`, only its events are recorded, from the time that it runs. `limit` bytes
    are kept for a recorder that stalls; at the end it has `patience_s` seconds to take each part
    of them and to complete the file. Raise ``click.ClickException`` if recording is impossible.
    """
    recorder = find_recorder(board)
    if file is not None:
        if recorder is not None:
            process = process_text(recorder, "process")
            raise click.ClickException(
                f"{process} records the machines of {board.name!r} already: "
                f"end it, or leave out --record; nothing was run"
            )
        with _recorder(file, board, patience_s):
            yield _recorded_environment(board, plan, clock, live, limit, patience_s)
        return
    environment: Environment | None = None
    if recorder is not None and not forks:
        try:
            environment = _recorded_environment(board, plan, clock, live, limit, patience_s)
        except WhiteboardError as error:  # another's recording is no reason not to run
            logger().warning("the machines go on unrecorded: %s", error)
    yield environment or live(board, clock, will_after_ms=plan.will_after_ms)


def _recorded_environment(
    board: Whiteboard,
    plan: Plan,
    clock: Clock | None,
    live: MakeEnvironment,
    limit: int,
    patience_s: float,
) -> Environment:
    recorder = find_recorder(board)
    if recorder is None:
        raise click.ClickException("the recorder does not record machines, nothing was run")
    handover = Handover(board, recorder, whole=True, limit=limit, patience_s=patience_s)
    handover.journal.add(("Plan", plan, str(Path.cwd())))
    world = live(board, clock, handover=handover, will_after_ms=plan.will_after_ms)
    return JournalledEnvironment(world, handover.journal)


@contextmanager
def _recorder(file: Path, board: Whiteboard, patience_s: float) -> Iterator[None]:
    """Record the board by another process, which ends when our end of its input is closed."""
    process = subprocess.Popen(
        [
            *(sys.executable, "-m", "llfsm.cli", "record", "--until-eof"),
            *("-o", str(file)),
            *BoardPlace(board.name, str(board.path.parent)).arguments,
        ],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        start_new_session=True,  # Ctrl-C ends the machines, and it has to record their last events
    )
    assert process.stdin is not None
    assert process.stdout is not None
    try:
        with process.stdout as output:
            if not output.readline():
                raise click.ClickException("the recorder did not start, nothing was run")
        yield
    finally:
        process.stdin.close()
        try:
            process.wait(patience_s)
        except subprocess.TimeoutExpired:
            process.kill()  # the file can be read as it is
            process.wait()
