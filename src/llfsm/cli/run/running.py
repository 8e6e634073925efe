"""The arrangement of ``llfsm run``: loaded with what reports of it, and run to its end."""

from __future__ import annotations

import threading
from typing import NamedTuple

import click

from llfsm.runtime.debugging.debugger import Debugger
from llfsm.runtime.debugging.obeying import LEASE_S
from llfsm.runtime.engine.arrangement import Arrangement
from llfsm.runtime.engine.environment import Environment
from llfsm.runtime.engine.events import Reason
from llfsm.runtime.engine.watchdog import running_call
from llfsm.runtime.plans.plan import Plan, assemble

from ..called_bundles import with_called_bundles
from ..ending import SIGNALS, ending_once
from .arguments import ResolvedPlan
from .code_breakpoints import pausing_at_breakpoints
from .report import StateReport, SuspensionReport, conditions, latency_drawing, timing_table

__all__ = ["Reports", "load_machines", "run_machines"]


class Reports(NamedTuple):
    """What is printed of machines: the options ``-v`` (how often), ``-s`` and ``-t``."""

    verbose: int
    suspensions: bool
    timed: bool


def load_machines(
    resolved: ResolvedPlan, plan: Plan, reports: Reports, environment: Environment
) -> Arrangement:
    """Return the arrangement of a plan, with its breakpoints; `resolved` has its classes."""
    arrangement = assemble(
        plan, resolved.classes, environment, library=resolved.library, timed=reports.timed
    )
    if plan.on_pause != "keep" or plan.breakpoints:
        debugger = Debugger(arrangement, on_pause=plan.on_pause, lease_s=LEASE_S)
        library = with_called_bundles(resolved.classes) if plan.breakpoints else {}
        debugger.break_at(*plan.breakpoints, library=library)
    if reports.verbose:
        with_path = reports.verbose > 1
        arrangement.attach(StateReport(arrangement, with_path=with_path, with_times=reports.timed))
    if reports.suspensions:
        arrangement.attach(SuspensionReport(arrangement))
    return arrangement


def run_machines(arrangement: Arrangement, *, timed: bool) -> None:
    """Run it to its end, and print its times if it is timed; raise what `run` raises.

    Raise `click.ClickException` if machines have failed that nobody can resume.
    """

    def is_ending() -> bool:
        return arrangement.reason is not None or arrangement.stop_cause in SIGNALS

    def is_in_a_section() -> bool:  # elsewhere it ends by itself, or has locks
        return running_call(threading.get_ident()) is not None

    try:
        with pausing_at_breakpoints(arrangement):
            ending_once(arrangement.run, is_ending, is_in_a_section)
    finally:
        if timed:
            found = arrangement.statistics()
            if found:
                texts = (timing_table(found), conditions(found), latency_drawing(found))
                click.echo("\n".join(filter(None, texts)), err=True)
    if arrangement.reason is Reason.FAILED:
        failed = ", ".join(arrangement.failed_machines)
        raise click.ClickException(
            f"{failed} failed, and no other process can resume it: the run has ended"
        )
