"""``llfsm record``, ``replay`` and ``rerun``: keep a run, bring it back, and run it again."""

from __future__ import annotations

import importlib.metadata
import json
import logging
import sys
import time
from collections.abc import Callable
from pathlib import Path

import click
import msgspec
from msgspec.structs import replace

from llfsm.runtime.commands.options import board_option
from llfsm.runtime.commands.planned import Planned, plan_of
from llfsm.runtime.dispatch import DispatchTable
from llfsm.runtime.plan import Plan, PlannedMachine, assemble
from llfsm.runtime.remote import host_name
from llfsm.runtime.signals import stop_on_signals
from llfsm.whiteboard import Whiteboard
from llfsm.whiteboard.schema import to_plain

from .errors import NoEventsError
from .reader import Recording
from .recorder import BoardRecorder, JournalRecorder
from .recorder import record as record_until
from .replay import Replay
from .rerun import Rerun
from .writer import RecordingWriter

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
@click.option("--events", type=int, hidden=True)  # where `llfsm run --record` writes its journal
def record(
    output: Path,
    board: str,
    slots: tuple[str, ...],
    max_size: float | None,
    max_time: float | None,
    events: int | None,
) -> None:
    """Record a whiteboard, until Ctrl-C or it is removed, for `llfsm view` and other MCAP tools.

    What is recorded can be read even if this process is killed, up to its last second. What
    machines do in each turn is only known to `llfsm run --record FILE`, which `llfsm rerun` needs.

    \b
    llfsm record -o run.mcap
    llfsm record -o poses.mcap --slots '*/pose' --max-time 60
    """
    logging.basicConfig(level=logging.WARNING, format="%(message)s", stream=sys.stderr)
    about = {
        "board": board,
        "host": host_name(),
        "version": importlib.metadata.version("llfsm"),
    }
    asked: list[str] = []  # the signal by which an end is
    with (
        stop_on_signals(asked.append),
        Whiteboard(board, create=False) as wb,
        RecordingWriter(output, about) as writer,
    ):
        recorder = BoardRecorder(wb, writer, slots)
        journal = None if events is None else JournalRecorder(events, writer)
        click.echo(f"recording the whiteboard {board!r} to {output}")
        sys.stdout.flush()
        until = float("inf") if max_time is None else time.monotonic() + max_time
        largest = float("inf") if max_size is None else max_size * _MB

        def is_over() -> bool:
            return bool(asked) or time.monotonic() >= until or writer.size >= largest

        record_until(recorder, journal, writer, is_over)
    missed = sum(writer.missed().values())
    click.echo(f"{output}: {writer.messages} messages, {missed} more came too fast", err=True)


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

    The recording is one of `llfsm run --record`. Without MACHINES those that it names run; else
    they take the places of the recorded ones, in the same order. The exit status is 0 if all that
    they do is as recorded, else 1.

    \b
    llfsm rerun run.mcap
    llfsm rerun run.mcap Patrol=my_robot.patrol:BetterPatrol
    """
    # How late turns were, and what failed, was told then.
    logging.getLogger("llfsm.runtime").setLevel(logging.CRITICAL)
    recording = Recording(file)
    again = Rerun(recording.entries, str(file))
    planned = _planned(recording, machines)
    assemble(
        planned.plan, planned.classes, again.board, library=planned.library, make=again.arrange
    )
    difference = again.compare()
    if difference is not None:
        raise click.ClickException(f"{file}: {difference}")
    click.echo(f"all {again.events} events and messages are as recorded")


def _planned(recording: Recording, machines: tuple[str, ...]) -> Planned:
    """Return the plan of a recording, with other machines in their places if any are given."""
    found = next((entry for entry in recording.entries if entry["event"] == "Plan"), None)
    if found is None:
        raise NoEventsError(
            f"{recording.path} does not say how its machines were made: "
            f"rerun it from Python, with llfsm.bridges.recording.rerun"
        )
    kind = DispatchTable if "slots" in found["plan"] else Plan
    plan = msgspec.convert(found["plan"], kind)
    if machines:
        given = plan_of(machines, None, (), ()).plan.machines
        if len(given) != len(plan.machines):
            names = ", ".join(each.name or each.definition for each in plan.machines)
            raise click.UsageError(f"the recording is of {len(plan.machines)} machines: {names}")
        plan = replace(plan, machines=tuple(map(_in_place_of, plan.machines, given)))
    return Planned(plan, [Path(), Path(found["folder"])])


def _in_place_of(recorded: PlannedMachine, given: PlannedMachine) -> PlannedMachine:
    return replace(
        recorded,
        definition=given.definition,
        name=given.name or recorded.name,
        variables={**recorded.variables, **given.variables},
        slots={**recorded.slots, **given.slots},
    )
