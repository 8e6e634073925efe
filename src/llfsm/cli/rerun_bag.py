"""``llfsm rerun`` of a bag: machines run on its topics."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import click
from msgspec.structs import replace

from llfsm.bridges.recording.bag_run import BagRun, bag_script
from llfsm.bridges.recording.reader import Recording
from llfsm.bridges.recording.replay_recorder import record_replay
from llfsm.bridges.ros2.bridging.machine_config import used_slots
from llfsm.runtime.verification import Member

from .run.arguments import ResolvedPlan, parse_arguments

__all__ = ["rerun_bag"]


def rerun_bag(recording: Recording, machines: Sequence[str], recorded: Path | None) -> None:
    """Run machines, named as for `llfsm run`, and write what they do to the file `recorded`.

    Raise ``click.ClickException`` with the first message that they post otherwise than in the bag.
    """
    if not machines:
        raise click.UsageError(
            f"{recording.path} is a bag: name the machines that are to read its topics"
        )
    resolved = parse_arguments(machines, None, (), ())
    plan = resolved.plan
    members = list(_members(resolved))
    slots = [machine.slots for machine in plan.machines]
    read, posted = used_slots(zip(resolved.classes.values(), slots, strict=True))
    script = bag_script(
        recording,
        {name: slot for name, slot in read.items() if name not in posted},
        idle_ms=plan.idle_us / 1e3 or 1.0,
        period_ms=None if plan.period_us is None else plan.period_us / 1e3,
    )
    accepting = plan.unload_accepting
    if recorded is not None:
        again = replace(plan, period_us=None)  # the times of its rounds are recorded
        record_replay(recorded, members, script, plan=again, unload_accepting=accepting)
    run = BagRun(recording, posted)
    difference = run.compare(members, script, unload_accepting=accepting)
    if difference is not None:
        raise click.ClickException(f"{recording.path}: {difference}")
    compared = ", ".join(f"{number} of {name}" for name, number in run.compared.items())
    click.echo(f"{run.rounds} rounds, all posted messages as recorded: {compared or 'none'}")
    if unknown := [name for name in posted if name not in run.compared]:
        click.echo(f"not compared, as they are not topics there: {', '.join(unknown)}", err=True)


def _members(resolved: ResolvedPlan) -> Iterator[Member]:
    for (name, cls), each in zip(resolved.classes.items(), resolved.plan.machines, strict=True):
        if each.preload or each.period_us is not None:
            why = "is preloaded" if each.preload else "has a period of its own"
            raise click.UsageError(f"{name} {why}: machines cannot be run so on a bag")
        yield Member(cls, name, each.variables, each.slots, each.suspended)
