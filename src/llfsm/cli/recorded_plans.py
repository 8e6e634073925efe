"""The machines of a recording, with the code that is to run in their places."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import click
import msgspec
from msgspec.structs import replace

from llfsm.bridges.recording.errors import NoEventsError, RecordingFileError
from llfsm.bridges.recording.kept_travel import Travelled, travelling
from llfsm.bridges.recording.reader import RecordedJournal, Recording
from llfsm.bridges.recording.rerun import Rerun, whole_journals
from llfsm.bridges.recording.travel_host import Serve
from llfsm.runtime.plans.dispatch import DispatchTable
from llfsm.runtime.plans.plan import Plan, PlannedMachine, assemble

from .called_bundles import with_called_bundles
from .run.arguments import ResolvedPlan, parse_arguments

__all__ = ["plan_of_one", "plans_to_rerun", "travel_through"]


def plans_to_rerun(
    recording: Recording, machines: Sequence[str], *, trust: bool
) -> list[tuple[RecordedJournal, ResolvedPlan]]:
    """Return each arrangement that can be run again; `machines` take the recorded ones' places.

    Without any, the file decides which code runs, if the user has chosen to `trust` it. Raise
    `RecordingError` without a valid plan, and ``click.UsageError`` for other machines.
    """
    return _resolve(recording, whole_journals(recording), machines, trust=trust)


def plan_of_one(
    recording: Recording, machines: Sequence[str], *, trust: bool
) -> tuple[RecordedJournal, ResolvedPlan]:
    """Return the only arrangement, or that whose machines have the names of `machines`.

    Raise what `plans_to_rerun` raises.
    """
    journals = whole_journals(recording)
    if len(journals) > 1:
        names = {journal.about.get("machines", "?"): journal for journal in journals}
        given = parse_arguments(machines, None, (), ()).classes if machines else ()
        found = names.get(", ".join(given))
        if found is None or len(names) < len(journals):
            raise click.UsageError(
                f"{recording.path} is of several arrangements: {'; '.join(names)}: "
                f"name the machines of one"
            )
        journals = [found]
    return _resolve(recording, journals, machines, trust=trust)[0]


def travel_through(
    recording: Recording,
    journal: RecordedJournal,
    resolved: ResolvedPlan,
    serve: Serve,
    read_line: Callable[[], str] = lambda: "",
) -> Travelled:
    """Return what goes through a recording, with the machines of a plan, as `travelling` does."""

    def again() -> Rerun:
        rerun = Rerun(recording.entries(journal), str(recording.path))
        plan, library = resolved.plan, resolved.library
        assemble(plan, resolved.classes, rerun.environment, library=library)
        return rerun

    library = with_called_bundles(resolved.classes)
    return travelling(again, library, recording.span_ns[0], serve, read_line)


def _resolve(
    recording: Recording,
    journals: Sequence[RecordedJournal],
    machines: Sequence[str],
    *,
    trust: bool,
) -> list[tuple[RecordedJournal, ResolvedPlan]]:
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
    given = parse_arguments(machines, None, (), ()).plan.machines if machines else ()
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
