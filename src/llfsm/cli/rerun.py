"""``llfsm rerun``: machines run again on the inputs of a recording."""

from __future__ import annotations

import logging
from pathlib import Path

import click

from llfsm.bridges.recording.bags import BagTopics
from llfsm.bridges.recording.differences import COMPARISONS, Comparison
from llfsm.bridges.recording.reader import Recording
from llfsm.bridges.recording.rerun import Rerun, why_not
from llfsm.runtime.plans.plan import assemble

from .bridge.configured import Configured
from .options import given_option, recording_argument, topics_option, trust_option
from .recorded_plans import plans_to_rerun

__all__ = ["rerun"]


@click.command()
@recording_argument
@click.argument("machines", nargs=-1)
@trust_option
@click.option(
    "--compare",
    type=click.Choice(list(COMPARISONS)),
    default="all",
    help="What must be as recorded: all events (default), states and posts, or posts alone.",
)
@topics_option
@click.option(
    "--record",
    "recorded",
    metavar="FILE",
    type=click.Path(path_type=Path),
    help="For a bag: record what the machines do on its topics.",
)
def rerun(
    file: Path,
    machines: tuple[str, ...],
    trust: bool,
    compare: Comparison,
    config: Path | None,
    recorded: Path | None,
) -> None:
    """Run MACHINES on the inputs of a recording and report the first difference in behaviour.

    The recording must have started before the machines, as with `llfsm run --record`. MACHINES take
    the places of the recorded ones, in the same order. The exit status is 0 if
    everything compared is as recorded, else 1.

    FILE may be a rosbag2 bag. The machines then read its topics, and what they post is compared
    with the topics of the slots to which they post.

    \b
    llfsm rerun run.mcap --trust
    llfsm rerun run.mcap Patrol=my_robot.patrol:BetterPatrol --compare posts
    llfsm rerun bag.mcap my_robot.patrol:Patrol --config bridge.toml --record run.mcap
    """
    # Late turns and failures were reported at the time of the recording.
    logging.getLogger("llfsm.runtime").setLevel(logging.CRITICAL)
    recording = Recording(file, BagTopics(Configured.read(config).config))
    if recording.is_bag:
        if events := given_option("trust", "compare"):
            raise click.UsageError(f"{file} is a bag, without events of machines: omit {events}")
        from .rerun_bag import rerun_bag  # here, as it imports more

        rerun_bag(recording, machines, recorded)
        return
    if of_bag := given_option("config", "recorded"):
        raise click.UsageError(f"{file} is not a bag: omit {of_bag}")
    number, lost = 0, False
    for journal, resolved in plans_to_rerun(recording, machines, trust=trust):
        again = Rerun(recording.entries(journal), str(file), compare)
        assemble(resolved.plan, resolved.classes, again.environment, library=resolved.library)
        difference = again.compare()
        if difference is not None:
            raise click.ClickException(f"{file}: {difference}")
        number, lost = number + again.events, lost or again.lost
    for journal in recording.journals:
        if not journal.whole:
            click.echo(f"not rerun: {why_not(journal)}", err=True)
    until = ", up to the first that the recorder lost" if lost else ""
    which = "" if compare == "all" else f" of {compare}"
    click.echo(f"all {number} events and messages{which} are as recorded{until}")
