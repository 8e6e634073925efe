"""``llfsm rerun``: run machines again on the inputs of a recording, or on the topics of a bag.

A recording names the definitions and the folder of its machines. To run them is to trust whoever
wrote the file, so that needs ``--trust``; else the user names the machines to run in their places.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import click
import msgspec
from msgspec.structs import replace

from llfsm.bridges.recording.bags import BagTopics
from llfsm.bridges.recording.errors import RecordingError, RecordingFileError
from llfsm.bridges.recording.reader import RecordedJournal, Recording
from llfsm.bridges.recording.recorders import record_script
from llfsm.bridges.recording.replay import BagRerun, BagScript
from llfsm.bridges.recording.rerun import COMPARISONS, Comparison, Rerun, whole_journals, why_not
from llfsm.bridges.recording.reversing.client import Client, start_client
from llfsm.bridges.recording.reversing.worker import Serve
from llfsm.bridges.ros2.bridging.machine_config import used_slots
from llfsm.cli.bridge.configured import Configured
from llfsm.cli.echo import echo
from llfsm.cli.machines import ResolvedPlan, parse_arguments
from llfsm.cli.options import (
    file_option,
    given_option,
    recording_argument,
    topics_option,
    trust_option,
)
from llfsm.runtime.debugging.breakpoints import callable_machines
from llfsm.runtime.plans import DispatchTable, Plan, PlannedMachine
from llfsm.runtime.verification import Member


def plan_of_one(
    recording: Recording, machines: Sequence[str], *, trust: bool
) -> tuple[RecordedJournal, ResolvedPlan]:
    """Find the only arrangement, or the one whose machines have the names of `machines`."""
    journals = whole_journals(recording)
    if len(journals) > 1:
        names = {journal.about.get("machines", "?"): journal for journal in journals}
        given = parse_arguments(machines).classes if machines else ()
        found = names.get(", ".join(given))
        if found is None or len(names) < len(journals):
            raise click.UsageError(
                f"{recording.path} is of several arrangements: {'; '.join(names)}: "
                f"name the machines of one"
            )
        journals = [found]
    return _resolve(recording, journals, machines, trust=trust)[0]


def reverse_debugging(
    recording: Recording,
    journal: RecordedJournal,
    resolved: ResolvedPlan,
    serve: Serve,
    read_line: Callable[[], str] = lambda: "",
) -> Client:
    """Open the machines of a plan for reverse debugging in a recording, as `start_client` does."""

    def again() -> Rerun:
        rerun = Rerun(recording.entries(journal), str(recording.path))
        resolved.assemble(rerun.environment)
        return rerun

    _log_no_failures()
    library = callable_machines(resolved.classes)
    return start_client(again, library, recording.span_ns[0], serve, read_line)


def _log_no_failures() -> None:
    """Log no late turns and failures again, which were reported at the time of the recording."""
    logging.getLogger("llfsm.runtime").setLevel(logging.CRITICAL)


def _resolve(
    recording: Recording,
    journals: Sequence[RecordedJournal],
    machines: Sequence[str],
    *,
    trust: bool,
) -> list[tuple[RecordedJournal, ResolvedPlan]]:
    """Find the plans of arrangements of a recording; `machines` replace the recorded ones.

    Without any, the file decides which code runs, if the user has chosen to `trust` it. Raise
    `RecordingError` without a valid plan, and ``click.UsageError`` for other machines.
    """
    plans = _plans(journals, recording.path)
    if not machines and not trust:
        recorded = "; ".join(
            f"{' '.join(each.definition for each in plan.machines)} in {_folder(journal)}"
            for journal, plan in zip(journals, plans, strict=True)
        )
        raise click.UsageError(
            f"which machines? The recording names {recorded}: name them yourself, or --trust the "
            f"file to decide which code runs"
        )
    given = parse_arguments(machines).plan.machines if machines else ()
    if given and len(given) != sum(len(plan.machines) for plan in plans):
        names = ", ".join(each.name or each.definition for plan in plans for each in plan.machines)
        raise click.UsageError(
            f"the recording has these machines: {names}; name one for each, in this order"
        )
    resolved = []
    for journal, plan in zip(journals, plans, strict=True):
        if given:
            ours, given = given[: len(plan.machines)], given[len(plan.machines) :]
            plan = replace(plan, machines=tuple(map(_in_place_of, plan.machines, ours)))
        folders = [Path(), _folder(journal)] if trust else [Path()]
        resolved.append((journal, ResolvedPlan(plan, folders)))
    return resolved


def _plans(journals: Sequence[RecordedJournal], file: Path) -> list[Plan]:
    plans = []
    for journal in journals:
        if "plan" not in journal.about:
            raise RecordingError(
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
    """Return the folder in which the machines were started, as the recording names it."""
    return Path(journal.about.get("folder", ""))


def _in_place_of(recorded: PlannedMachine, given: PlannedMachine) -> PlannedMachine:
    return replace(
        recorded,
        definition=given.definition,
        name=given.name or recorded.name,
        variables={**recorded.variables, **given.variables},
        slots={**recorded.slots, **given.slots},
    )


def rerun_bag(recording: Recording, machines: Sequence[str], recorded: Path | None) -> None:
    """Run machines, named as for `llfsm run`, on a bag's topics; compare what they post with it.

    What they do is written to the file `recorded`, if any. Raise ``click.ClickException`` with the
    first message that they post otherwise than in the bag.
    """
    if not machines:
        raise click.UsageError(
            f"{recording.path} is a bag: name the machines that are to read its topics"
        )
    resolved = parse_arguments(machines)
    plan = resolved.plan
    members = list(_members(resolved))
    slots = [machine.slots for machine in plan.machines]
    read, posted = used_slots(zip(resolved.classes.values(), slots, strict=True))
    script = BagScript(
        recording,
        {name: slot for name, slot in read.items() if name not in posted},
        idle_ms=plan.idle_us / 1e3 or 1.0,
        period_ms=None if plan.period_us is None else plan.period_us / 1e3,
    )
    accepting = plan.unload_accepting
    if recorded is not None:
        again = replace(plan, period_us=None)  # the times of its rounds are recorded
        record_script(recorded, members, script, plan=again, unload_accepting=accepting)
    run = BagRerun(recording, posted)
    difference = run.compare(members, script, unload_accepting=accepting)
    if difference is not None:
        raise click.ClickException(f"{recording.path}: {difference}")
    compared = ", ".join(f"{number} of {name}" for name, number in run.compared.items())
    echo(f"{run.rounds} rounds, all posted messages as recorded: {compared or 'none'}")
    if unknown := [name for name in posted if name not in run.compared]:
        echo(f"not compared, as they are not topics there: {', '.join(unknown)}", err=True)


def _members(resolved: ResolvedPlan) -> Iterator[Member]:
    for (name, cls), each in zip(resolved.classes.items(), resolved.plan.machines, strict=True):
        if each.preload or each.period_us is not None:
            why = "is preloaded" if each.preload else "has a period of its own"
            raise click.UsageError(f"{name} {why}: machines cannot be run so on a bag")
        yield Member(cls, name, each.variables, each.slots, each.suspended)


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
@file_option("--record", "recorded", help="For a bag: record what the machines do on its topics.")
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
    _log_no_failures()
    recording = Recording(file, BagTopics(Configured.read(config).config))
    if recording.is_bag:
        if events := given_option("trust", "compare"):
            raise click.UsageError(f"{file} is a bag, without events of machines: omit {events}")
        rerun_bag(recording, machines, recorded)
        return
    if of_bag := given_option("config", "recorded"):
        raise click.UsageError(f"{file} is not a bag: omit {of_bag}")
    number, lost = 0, False
    for journal, resolved in _resolve(recording, whole_journals(recording), machines, trust=trust):
        again = Rerun(recording.entries(journal), str(file), compare)
        resolved.assemble(again.environment)
        difference = again.compare()
        if difference is not None:
            raise click.ClickException(f"{file}: {difference}")
        number, lost = number + again.events, lost or again.lost
    for journal in recording.journals:
        if not journal.whole:
            echo(f"not rerun: {why_not(journal)}", err=True)
    until = ", up to the first that the recorder lost" if lost else ""
    which = "" if compare == "all" else f" of {compare}"
    echo(f"all {number} events and messages{which} are as recorded{until}")
