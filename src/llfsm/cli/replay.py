"""``llfsm replay``: replay the messages of a recording to a whiteboard."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path

import click

from llfsm.bridges.recording.bags import BagTopics
from llfsm.bridges.recording.reader import Recording
from llfsm.bridges.recording.replay import BoardReplay
from llfsm.cli.bridge.configured import Configured
from llfsm.cli.echo import echo
from llfsm.cli.options import (
    BoardPlace,
    Number,
    board_option,
    recording_argument,
    slots_option,
    topics_option,
)
from llfsm.runtime.engine.realtime import stop_on_signals
from llfsm.whiteboard.schema import to_plain
from llfsm.whiteboard.slot_names import is_own


@click.command()
@recording_argument
@board_option
@slots_option
@topics_option
@click.option(
    "--speed",
    metavar="X",
    type=Number(0, min_open=True),
    default=1.0,
    help="Replay this many times as fast.",
)
@click.option(
    "--from",
    "from_s",
    metavar="S",
    type=Number(0),
    default=0.0,
    help="Begin at this second, with every slot as it was then.",
)
@click.option("--loop", is_flag=True, help="Start over at the end, until Ctrl-C.")
@click.option("--step", is_flag=True, help="Go on to the next message or transition at each Enter.")
def replay(
    file: Path,
    board: BoardPlace,
    slots: tuple[str, ...],
    config: Path | None,
    speed: float,
    from_s: float,
    loop: bool,
    step: bool,
) -> None:
    """Post the messages of a recording to a whiteboard, at their recorded times.

    FILE may also be a rosbag2 bag: an MCAP file, a .db3 file or the folder of a bag.

    Requests to machines, such as suspend, are left out unless --slots names their slots.

    \b
    llfsm replay run.mcap -b again --speed 2
    llfsm replay run.mcap --slots turtle1/pose --loop
    """
    recording = _open(file, config, from_s)
    signals: list[str] = []  # that asked this process to end
    with stop_on_signals(signals.append), board.open() as wb:
        player = BoardReplay(recording, wb, slots)

        def is_over() -> bool:
            return bool(signals) or not wb.alive

        again = True
        while again and not is_over():
            if step:
                _step(player, from_s, is_over)
            else:
                player.play(is_over, speed=speed, from_s=from_s)
            again = loop


def _open(file: Path, config: Path | None, from_s: float) -> Recording:
    recording = Recording(file, BagTopics(Configured.read(config).config))
    begin_ns, end_ns = recording.span_ns
    if from_s > (end_ns - begin_ns) / 1e9:
        raise click.UsageError(f"--from {from_s:g}: it ends after {(end_ns - begin_ns) / 1e9:g} s")
    return recording


def _step(player: BoardReplay, from_s: float, is_over: Callable[[], bool]) -> None:
    """Post step by step, and wait for Enter after each in which something is to be seen."""
    for step in player.steps(from_s=from_s):
        posted = [each for each in step.posted if not is_own(each.slot)]
        if not (posted or step.moved):
            continue
        echo(f"{step.now_ns / 1e9:.6f} s  {step.text}".rstrip())
        for slot, message in posted:
            echo(f"  {slot} {json.dumps(to_plain(message), ensure_ascii=False)}")
        if is_over() or not sys.stdin.readline():
            return
