"""``llfsm rerun``: machines run again on the inputs of a recording."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click
import msgspec
from msgspec.structs import replace

from llfsm.bridges.recording.differences import COMPARISONS, Comparison
from llfsm.bridges.recording.errors import NoEventsError, RecordingFileError
from llfsm.bridges.recording.reader import RecordedJournal, Recording
from llfsm.bridges.recording.rerun import Rerun, whole_journals, why_not
from llfsm.runtime.plans.dispatch import DispatchTable
from llfsm.runtime.plans.plan import Plan, PlannedMachine, assemble

from .options import recording_argument
from .run.arguments import ResolvedPlan, parse_arguments

__all__ = ["rerun"]


@click.command()
@recording_argument
@click.argument("machines", nargs=-1)
@click.option(
    "--trust",
    is_flag=True,
    help="Run the machines that the file names, from the folder that it names.",
)
@click.option(
    "--compare",
    type=click.Choice(list(COMPARISONS)),
    default="all",
    help="What must be as recorded: all events (default), states and posts, or posts alone.",
)
def rerun(file: Path, machines: tuple[str, ...], trust: bool, compare: Comparison) -> None:
    """Run MACHINES on the inputs of a recording and report the first difference in behaviour.

    The recording must have begun before the machines, as with `llfsm run --record`. MACHINES take
    the places of the recorded ones, in the same order. The exit status is 0 if all that is
    compared is as recorded, else 1.

    \b
    llfsm rerun run.mcap --trust
    llfsm rerun run.mcap Patrol=my_robot.patrol:BetterPatrol --compare posts
    """
    # Late turns and failures were reported at the time of the recording.
    logging.getLogger("llfsm.runtime").setLevel(logging.CRITICAL)
    recording = Recording(file)
    journals = whole_journals(recording)
    plans = _plans(journals, file)
    if not machines and not trust:
        recorded = "; ".join(
            f"{' '.join(each.definition for each in plan.machines)} in {_folder(journal)}"
            for journal, plan in zip(journals, plans, strict=True)
        )
        raise click.UsageError(
            f"which machines? The recording names {recorded}: name them yourself, or --trust the "
            f"file to decide which code runs"
        )
    given = parse_arguments(machines, None, (), ()).plan.machines if machines else ()
    if given and len(given) != sum(len(plan.machines) for plan in plans):
        names = ", ".join(each.name or each.definition for plan in plans for each in plan.machines)
        raise click.UsageError(f"the recording has these machines: {names}")
    number, lost = 0, False
    for journal, plan in zip(journals, plans, strict=True):
        if given:
            ours, given = given[: len(plan.machines)], given[len(plan.machines) :]
            plan = replace(plan, machines=tuple(map(_in_place_of, plan.machines, ours)))
        resolved = ResolvedPlan(plan, [Path(), _folder(journal)] if trust else [Path()])
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


def _plans(journals: Sequence[RecordedJournal], file: Path) -> list[Plan]:
    """Return the plans of the recorded arrangements; raise `RecordingError` without a valid one."""
    plans = []
    for journal in journals:
        if "plan" not in journal.about:
            raise NoEventsError(
                f"{file} has no plan of its machines: "
                f"rerun it from Python, with llfsm.bridges.recording.rerun"
            )
        try:
            plain = msgspec.json.decode(journal.about["plan"], type=dict[str, Any])
            plans.append(msgspec.convert(plain, DispatchTable if "slots" in plain else Plan))
        except (ValueError, RecursionError) as error:
            raise RecordingFileError(f"{file}: its plan of machines is invalid: {error}") from error
    return plans


def _folder(journal: RecordedJournal) -> Path:
    """Return the folder in which the machines were started."""
    return Path(journal.about.get("folder", ""))


def _in_place_of(recorded: PlannedMachine, given: PlannedMachine) -> PlannedMachine:
    return replace(
        recorded,
        definition=given.definition,
        name=given.name or recorded.name,
        variables={**recorded.variables, **given.variables},
        slots={**recorded.slots, **given.slots},
    )
