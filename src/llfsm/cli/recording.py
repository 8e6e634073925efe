"""``llfsm record``, ``replay`` and ``rerun``: keep a run, bring it back, and run it again."""

from __future__ import annotations

import importlib.metadata
import json
import logging
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import click
import msgspec
from msgspec.structs import replace

from llfsm.bridges.recording.errors import NoEventsError, RecordingError
from llfsm.bridges.recording.reader import RecordedJournal, Recording
from llfsm.bridges.recording.receiver import JournalReceiver
from llfsm.bridges.recording.recorder import BoardRecorder
from llfsm.bridges.recording.recorder import record as record_until
from llfsm.bridges.recording.replay import Replay
from llfsm.bridges.recording.rerun import Rerun, whole_journals, why_not
from llfsm.bridges.recording.writer import EVENTS, RecordingWriter
from llfsm.runtime.engine.signals import stop_on_signals
from llfsm.runtime.plans.dispatch import DispatchTable
from llfsm.runtime.plans.plan import Plan, PlannedMachine, assemble
from llfsm.whiteboard import (
    BoardClosedError,
    BoardNotFoundError,
    Whiteboard,
    WhiteboardError,
)
from llfsm.whiteboard.liveness import host_name
from llfsm.whiteboard.schema import to_plain

from .options import board_option
from .run.arguments import Planned, plan_of
from .supervised import end_with_input, until_eof_option

__all__ = ["record", "replay", "rerun"]

_MB = 1_000_000

_file_argument = click.argument("file", type=click.Path(path_type=Path))
_slots_option = click.option(
    "--slots",
    metavar="GLOB",
    multiple=True,
    help="Only slots whose names match, as 'turtle1/*'; may be given several times.",
)


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
@_slots_option
@click.option("--max-size", metavar="MB", type=click.FloatRange(0.001), help="End when so large.")
@click.option("--max-time", metavar="S", type=click.FloatRange(0), help="End after so long.")
@until_eof_option
def record(
    output: Path,
    board: str,
    slots: tuple[str, ...],
    max_size: float | None,
    max_time: float | None,
    until_eof: bool,
) -> None:
    """Record a whiteboard and its machines, until Ctrl-C or it is removed; make it if need be.

    What is recorded can be read even if this process is killed, up to its last second, by
    `llfsm view` and other MCAP tools. Machines that start later can be run again from it, by
    `llfsm rerun`; of those that run already the events are recorded from now on.

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
    asked: list[str] = []  # the signal by which an end is
    with (
        stop_on_signals(asked.append),
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
            return bool(asked) or time.monotonic() >= until or writer.size >= largest

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
    """Open a board; make it if nobody has, so that who comes later is recorded from its start.

    One that was made is removed if nothing was recorded for an error.
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


def _receiver(board: Whiteboard, writer: RecordingWriter) -> JournalReceiver | None:
    """Return what records the machines; None, and say why, if that cannot be."""
    try:
        receiver = JournalReceiver(board, writer)
    except BoardClosedError:
        raise
    except WhiteboardError as error:  # a board that is full can be recorded all the same
        click.echo(f"only slots are recorded, no events of machines: {error}", err=True)
        return None
    if receiver.other:
        text = f"process {receiver.other} records the machines already, this one only slots"
        click.echo(text, err=True)
        return None
    return receiver


@click.command()
@_file_argument
@board_option
@_slots_option
@click.option(
    "--speed",
    metavar="X",
    type=click.FloatRange(0, min_open=True),
    default=1.0,
    help="So many times as fast as it was.",
)
@click.option(
    "--from",
    "from_s",
    metavar="S",
    type=click.FloatRange(0),
    default=0.0,
    help="Begin at this second, with all slots as they were then.",
)
@click.option("--loop", is_flag=True, help="Begin again at the end, until Ctrl-C.")
@click.option("--step", is_flag=True, help="Post what belongs to one ringlet at each Enter.")
def replay(
    file: Path,
    board: str,
    slots: tuple[str, ...],
    speed: float,
    from_s: float,
    loop: bool,
    step: bool,
) -> None:
    """Post what is in a recording to a whiteboard, as it came then.

    What live machines were asked for, as to suspend, is left out unless --slots names it.

    \b
    llfsm replay run.mcap -b again --speed 2
    llfsm replay run.mcap --slots turtle1/pose --loop
    """
    recording = _open(file, from_s)
    asked: list[str] = []  # the signal by which an end is
    with stop_on_signals(asked.append), Whiteboard(board) as wb:
        player = Replay(recording, wb, slots)

        def is_over() -> bool:
            return bool(asked) or not wb.alive

        again = True
        while again and not is_over():
            if step:
                _step(player, from_s, is_over)
            else:
                player.play(is_over, speed=speed, from_s=from_s)
            again = loop


def _open(file: Path, from_s: float) -> Recording:
    recording = Recording(file)
    begin_ns, end_ns = recording.span_ns
    if from_s > (end_ns - begin_ns) / 1e9:
        raise click.UsageError(f"--from {from_s:g}: it ends after {(end_ns - begin_ns) / 1e9:g} s")
    return recording


def _step(player: Replay, from_s: float, is_over: Callable[[], bool]) -> None:
    for step in player.steps(from_s=from_s):
        click.echo(f"{step.now_ns / 1e9:.6f} s  {step.text}".rstrip())
        for slot, message in step.posted:
            click.echo(f"  {slot} {json.dumps(to_plain(message), ensure_ascii=False)}")
        if is_over() or not sys.stdin.readline():
            return


@click.command()
@_file_argument
@click.argument("machines", nargs=-1)
def rerun(file: Path, machines: tuple[str, ...]) -> None:
    """Run MACHINES on what they learnt in a recording, and tell what they do differently first.

    The recording is one that was there when they began, as with `llfsm run --record`. Without
    MACHINES those that it names run; else they take the places of the recorded ones, in the same
    order. The exit status is 0 if all that they do is as recorded, else 1.

    \b
    llfsm rerun run.mcap
    llfsm rerun run.mcap Patrol=my_robot.patrol:BetterPatrol
    """
    # How late turns were, and what failed, was told then.
    logging.getLogger("llfsm.runtime").setLevel(logging.CRITICAL)
    recording = Recording(file)
    journals = whole_journals(recording)
    plans = _plans(journals, file)
    given = plan_of(machines, None, (), ()).plan.machines if machines else ()
    if given and len(given) != sum(len(plan.machines) for plan in plans):
        names = ", ".join(each.name or each.definition for plan in plans for each in plan.machines)
        raise click.UsageError(f"the recording is of these machines: {names}")
    number, lost = 0, False
    for journal, plan in zip(journals, plans, strict=True):
        if given:
            ours, given = given[: len(plan.machines)], given[len(plan.machines) :]
            plan = replace(plan, machines=tuple(map(_in_place_of, plan.machines, ours)))
        planned = Planned(plan, [Path(), Path(journal.about["folder"])])
        again = Rerun(recording.entries(journal), str(file))
        assemble(
            planned.plan, planned.classes, again.board, library=planned.library, make=again.arrange
        )
        difference = again.compare()
        if difference is not None:
            raise click.ClickException(f"{file}: {difference}")
        number, lost = number + again.events, lost or again.lost
    for journal in recording.journals:
        if not journal.whole:
            click.echo(f"not run again: {why_not(journal)}", err=True)
    until = ", up to where some were lost as they were recorded" if lost else ""
    click.echo(f"all {number} events and messages are as recorded{until}")


def _plans(journals: Sequence[RecordedJournal], file: Path) -> list[Plan]:
    """Return what the arrangements were made from, or raise `NoEventsError`."""
    plans = []
    for journal in journals:
        if "plan" not in journal.about:
            raise NoEventsError(
                f"{file} does not say how its machines were made: "
                f"rerun it from Python, with llfsm.bridges.recording.rerun"
            )
        plain = msgspec.json.decode(journal.about["plan"])
        plans.append(msgspec.convert(plain, DispatchTable if "slots" in plain else Plan))
    return plans


def _in_place_of(recorded: PlannedMachine, given: PlannedMachine) -> PlannedMachine:
    return replace(
        recorded,
        definition=given.definition,
        name=given.name or recorded.name,
        variables={**recorded.variables, **given.variables},
        slots={**recorded.slots, **given.slots},
    )
