"""``llfsm record``: record a whiteboard and its machines to a file."""

from __future__ import annotations

import logging
import math
import sys
import time
from contextlib import nullcontext
from pathlib import Path

import click

from llfsm.bridges.recording.recorders import BoardRecorder, JournalRecorder
from llfsm.bridges.recording.recorders import record as record_until
from llfsm.bridges.recording.writer import EVENTS, RecordingWriter
from llfsm.cli import VERSION
from llfsm.cli.console import ending_once, log_to_console
from llfsm.cli.echo import echo
from llfsm.cli.options import (
    BoardPlace,
    Number,
    board_option,
    end_with_input,
    file_option,
    host_option,
    slots_option,
    until_eof_option,
)
from llfsm.cli.ps import shown_of
from llfsm.runtime.engine.realtime import stop_on_signals
from llfsm.runtime.presence.hosts import HostNames
from llfsm.whiteboard import BoardClosedError, Whiteboard, WhiteboardError
from llfsm.whiteboard.liveness import host_name

_MB = 1_000_000


@click.command()
@file_option("-o", "--output", required=True, help="The recording to make, an MCAP file.")
@board_option
@slots_option
@host_option
@click.option("--cdr", is_flag=True, help="Make a bag for ROS's tools: CDR, no machines' events.")
@click.option(
    "--max-size", metavar="MB", type=Number(0.001), default=math.inf, help="End at this size."
)
@click.option(
    "--max-time", metavar="S", type=Number(0), default=math.inf, help="End after this time."
)
@until_eof_option
def record(
    output: Path,
    board: BoardPlace,
    slots: tuple[str, ...],
    host: str,
    cdr: bool,
    max_size: float,
    max_time: float,
) -> None:
    """Record a whiteboard and its machines until Ctrl-C or until the whiteboard is removed.

    A whiteboard that does not exist yet is created. `llfsm view` and other MCAP tools can read the
    recording; if this process is killed, at most the last second is lost. Machines that start after
    the recorder can be rerun. For machines already running, only events from now on are recorded.
    With --cdr, it is a rosbag2 bag of the slots with ROS types. For another host of the fleet,
    machines' statuses and variables are recorded, but not their events.

    \b
    llfsm record -o run.mcap
    llfsm record -o poses.mcap --slots '*/pose' --max-time 60
    llfsm record -o robot7.mcap --host robot7
    """
    log_to_console(logging.WARNING)
    end_with_input()
    about = {"board": board.name, "host": host_name(), "version": VERSION}
    signals: list[str] = []  # that asked this process to end

    def run() -> None:
        with (
            stop_on_signals(signals.append),
            board.open(create=False) if host else board.opened() as wb,
            nullcontext(shown_of(wb, host)) as shown,  # before there is a file
            _writer(output, about, cdr) as writer,
        ):
            recorder = BoardRecorder(wb, writer, slots, shown)
            has_events = recorder.wants(EVENTS) and not cdr and host in ("", HostNames(wb).own)
            journals = _receiver(wb, writer) if has_events else None
            echo(f"recording the whiteboard {board.name!r} to {output}")
            sys.stdout.flush()
            until = time.monotonic() + max_time

            def is_over() -> bool:
                over = time.monotonic() >= until or writer.size >= max_size * _MB
                return over or bool(signals)

            try:
                record_until(recorder, journals, writer, is_over)
            finally:
                if journals is not None:
                    journals.close()
        missed = sum(writer.missed().values())
        text = f"{output}: {writer.messages} messages recorded, {missed} missed"
        if journals is not None and journals.journals:
            text += f"; {writer.events} events of machines"
            text += ", and some were lost" if writer.lost else ""
        echo(text, err=True)

    # `ros2 launch` sends SIGINT twice; the second must not cost the end of the recording.
    ending_once(run, lambda: bool(signals), lambda: False)


def _writer(output: Path, about: dict[str, str], cdr: bool) -> RecordingWriter:
    if not cdr:
        return RecordingWriter(output, about)
    from llfsm.bridges.recording.bags import BagWriter
    from llfsm.bridges.ros2.types import TypeLibrary

    return BagWriter(output, about, TypeLibrary())


def _receiver(board: Whiteboard, writer: RecordingWriter) -> JournalRecorder | None:
    """Open the receiver of the machines' events; print why if there cannot be one."""
    try:
        receiver = JournalRecorder(board, writer)
    except BoardClosedError:
        raise
    except WhiteboardError as error:  # a full board can be recorded all the same
        echo(f"only slots are recorded, no events of machines: {error}", err=True)
        return None
    if receiver.other:
        text = f"{receiver.other} records the machines already, this one only slots"
        echo(text, err=True)
        return None
    return receiver
