"""``llfsm record``: a whiteboard and its machines in a file."""

from __future__ import annotations

import importlib.metadata
import logging
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import click

from llfsm.bridges.recording.board_recorder import BoardRecorder
from llfsm.bridges.recording.board_recorder import record as record_until
from llfsm.bridges.recording.errors import RecordingError
from llfsm.bridges.recording.journal_recorder import JournalRecorder
from llfsm.bridges.recording.writer import EVENTS, RecordingWriter
from llfsm.runtime.engine.signals import stop_on_signals
from llfsm.whiteboard import (
    BoardClosedError,
    BoardNotFoundError,
    Whiteboard,
    WhiteboardError,
)
from llfsm.whiteboard.liveness import host_name

from .options import board_option, end_with_input, slots_option, until_eof_option

__all__ = ["record"]

_MB = 1_000_000


@click.command()
@click.option(
    "-o",
    "--output",
    metavar="FILE",
    required=True,
    type=click.Path(path_type=Path),
    help="The recording to make, an MCAP file.",
)
@board_option
@slots_option
@click.option("--max-size", metavar="MB", type=click.FloatRange(0.001), help="End at this size.")
@click.option("--max-time", metavar="S", type=click.FloatRange(0), help="End after this time.")
@until_eof_option
def record(
    output: Path,
    board: str,
    slots: tuple[str, ...],
    max_size: float | None,
    max_time: float | None,
    until_eof: bool,
) -> None:
    """Record a whiteboard and its machines until Ctrl-C or until the whiteboard is removed.

    A whiteboard that does not exist yet is created. `llfsm view` and other MCAP tools can read the
    recording; if this process is killed, all but the last second. `llfsm rerun` can run machines
    again that start after the recorder; of machines that run already, events are recorded from
    now on.

    \b
    llfsm record -o run.mcap
    llfsm record -o poses.mcap --slots '*/pose' --max-time 60
    """
    logging.basicConfig(level=logging.WARNING, format="%(message)s", stream=sys.stderr)
    if until_eof:
        end_with_input()
    about = {
        "board": board,
        "host": host_name(),
        "version": importlib.metadata.version("llfsm"),
    }
    signals: list[str] = []  # that asked this process to end
    with (
        stop_on_signals(signals.append),
        _opened(board) as wb,
        RecordingWriter(output, about) as writer,
    ):
        recorder = BoardRecorder(wb, writer, slots)
        journals = _receiver(wb, writer) if recorder.wants(EVENTS) else None
        click.echo(f"recording the whiteboard {board!r} to {output}")
        sys.stdout.flush()
        until = float("inf") if max_time is None else time.monotonic() + max_time
        largest = float("inf") if max_size is None else max_size * _MB

        def is_over() -> bool:
            return bool(signals) or time.monotonic() >= until or writer.size >= largest

        try:
            record_until(recorder, journals, writer, is_over)
        finally:
            if journals is not None:
                journals.close()
    missed = sum(writer.missed().values())
    text = f"{output}: {writer.messages} messages, {missed} more came too fast"
    if journals is not None and journals.journals:
        text += f"; {writer.events} events of machines"
        text += ", and some were lost" if writer.lost else ""
    click.echo(text, err=True)


@contextmanager
def _opened(name: str) -> Iterator[Whiteboard]:
    """Open a board; create it if need be, so that later machines are recorded from their start.

    A board created here is removed if an error prevents the recording.
    """
    try:
        wb = Whiteboard(name, create=False)
        made = False
    except BoardNotFoundError:
        wb = Whiteboard(name)
        made = True
    with wb:
        try:
            yield wb
        except RecordingError:
            if made and not wb.slots():
                wb.remove()
            raise


def _receiver(board: Whiteboard, writer: RecordingWriter) -> JournalRecorder | None:
    """Return the receiver of the machines' events, or print why there cannot be one."""
    try:
        receiver = JournalRecorder(board, writer)
    except BoardClosedError:
        raise
    except WhiteboardError as error:  # a full board can be recorded all the same
        click.echo(f"only slots are recorded, no events of machines: {error}", err=True)
        return None
    if receiver.other:
        text = f"process {receiver.other} records the machines already, this one only slots"
        click.echo(text, err=True)
        return None
    return receiver
