"""``llfsm run``: machines as one arrangement, with clfsm's options."""

from __future__ import annotations

import importlib.metadata
import logging
import sys
from pathlib import Path
from typing import Any, Literal

import click
from msgspec.structs import replace

from llfsm.runtime.engine.events import Reason
from llfsm.runtime.plans.plan import Plan, assemble
from llfsm.whiteboard import Whiteboard

from ..options import board_option, end_with_input, supervised_options
from .arguments import parse_arguments
from .nonstop import run_nonstop
from .recorder_process import recorded
from .report import StateReport, SuspensionReport, latency_drawing, timing_table

__all__ = ["run"]


class _Priority(click.IntRange):
    """A priority that may be left out, if no machine follows."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the number; a word is probably the machine that was to run."""
        if isinstance(value, str) and not value.lstrip("-").isdigit():
            self.fail(f"{value!r} is no priority; name the machines first", param, ctx)
        return super().convert(value, param, ctx)


@click.command()
@click.argument("machines", nargs=-1)
@click.option(
    "-S", "suspended", metavar="MACHINE", multiple=True, help="Load MACHINE as well, suspended."
)
@click.option(
    "-P",
    "preloaded",
    metavar="MACHINE",
    multiple=True,
    help="Preload MACHINE, for the others to load.",
)
@click.option(
    "-T",
    "table",
    metavar="TABLE",
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
    help="Run the machines of a dispatch table, each at its times.",
)
@click.option(
    "-v",
    "verbose",
    count=True,
    help="Print state changes: machine number, state number, machine, state; -vv: its path.",
)
@click.option("-s", "report", is_flag=True, help="Print suspends, resumes and restarts.")
@click.option(
    "-t", "timed", is_flag=True, help="Time the ringlets and print statistics at the end."
)
@click.option("-n", "nonstop", is_flag=True, help="Start again after a crash.")
@click.option("-q", "quiet", is_flag=True, help="Print no header.")
@click.option("-u", "keep", is_flag=True, help="Do not unload accepting machines.")
@click.option(
    "-i",
    "idle_us",
    metavar="US",
    type=click.IntRange(0),
    help="Sleep this many microseconds (10000) after a round in which no transition fired.",
)
@click.option(
    "--no-wake",
    is_flag=True,
    help="Sleep to the end, as clfsm does; else a new message for a machine ends the sleep.",
)
@click.option(
    "--period",
    "period_us",
    metavar="US",
    type=click.IntRange(1),
    help="Begin a round every US microseconds instead.",
)
@click.option(
    "--on-error",
    type=click.Choice(["stop", "suspend"]),
    help="If a machine's code raises: stop all (the default) or suspend that machine.",
)
@click.option(
    "--watchdog",
    "watchdog_ms",
    metavar="MS",
    type=click.IntRange(1),
    help="Report code of a machine that runs longer than MS milliseconds; post its safe values.",
)
@click.option(
    "--realtime",
    metavar="[PRIORITY]",
    type=_Priority(1, 99),
    is_flag=False,
    flag_value=50,
    help="Run at this priority (50) of SCHED_FIFO with locked memory; refused without the right.",
)
@click.option(
    "--cpu", metavar="N", type=click.IntRange(0), help="With --realtime: run on core N alone."
)
@click.option(
    "--will-after",
    "will_after_ms",
    metavar="MS",
    type=click.IntRange(500),
    help="Let guards post the safe values also if this process is silent for MS milliseconds.",
)
@click.option(
    "--record",
    "recording",
    metavar="FILE",
    type=click.Path(path_type=Path),
    help="Record the whiteboard and all that the machines do, for llfsm rerun.",
)
@board_option
@supervised_options
def run(
    machines: tuple[str, ...],
    suspended: tuple[str, ...],
    preloaded: tuple[str, ...],
    table: Path | None,
    verbose: int,
    report: bool,
    timed: bool,
    nonstop: bool,
    quiet: bool,
    keep: bool,
    idle_us: int | None,
    no_wake: bool,
    period_us: int | None,
    on_error: Literal["stop", "suspend"] | None,
    watchdog_ms: int | None,
    realtime: int | None,
    cpu: int | None,
    will_after_ms: int | None,
    recording: Path | None,
    board: str,
    until_eof: bool,
    remove_board: bool,
) -> None:
    """Run MACHINES, in this order, until all accept or are suspended, or Ctrl-C.

    A machine is one that ships, patrol.py:Patrol, or the folder of a bundle; name=machine
    gives it a name, name:variable=value sets a variable, name:slot:=other replaces a slot.
    Instead of machines, name an arrangement file (.toml).

    \b
    llfsm run RosPingPong -v
    llfsm run path/to/Patrol.machine
    llfsm run RosBlindTurttleBot TurtleSuspendResume -s
    llfsm run a=my_robot.patrol:Patrol a:rounds=3 a:turtle1/pose:=bob/pose
    llfsm run robot.toml -t
    """
    if nonstop and recording is not None:
        raise click.UsageError("--record keeps one run, -n may start several: leave out one")
    resolved = parse_arguments(machines, table, suspended, preloaded)
    plan = _with_options(
        resolved.plan,
        keep=keep,
        no_wake=no_wake,
        idle_us=idle_us,
        period_us=period_us,
        on_error=on_error,
        watchdog_ms=watchdog_ms,
        realtime=realtime,
        cpu=cpu,
        will_after_ms=will_after_ms,
    )
    _log()
    with (
        Whiteboard(_board(plan, board)) as wb,
        recorded(recording, wb, plan, forks=nonstop) as environment,
    ):
        try:
            arrangement = assemble(
                plan, resolved.classes, environment, library=resolved.library, timed=timed
            )
            if verbose:
                arrangement.attach(StateReport(arrangement, with_path=verbose > 1))
            if report:
                arrangement.attach(SuspensionReport(arrangement))
            if not quiet:
                version = importlib.metadata.version("llfsm")
                names = ", ".join(resolved.classes)
                click.echo(f"llfsm {version}: {names} on whiteboard {wb.name}", err=True)
            if until_eof:
                end_with_input()

            def execute() -> None:
                try:
                    reason = arrangement.run()
                finally:
                    if timed:
                        found = arrangement.statistics()
                        texts = (timing_table(found), latency_drawing(found))
                        click.echo("\n".join(filter(None, texts)), err=True)
                if reason is Reason.FAILED:
                    failed = ", ".join(arrangement.failed_machines)
                    raise click.ClickException(
                        f"{failed} failed, and no other process can resume it: the run has ended"
                    )

            if nonstop:
                run_nonstop(execute, arrangement.stop)
            else:
                execute()
        finally:
            if remove_board:
                wb.remove()


def _with_options(plan: Plan, *, keep: bool, no_wake: bool, **given: object) -> Plan:
    """Return the plan with the options of the command line, which override it."""
    if given["period_us"] is not None and any(machine.period_us for machine in plan.machines):
        raise click.UsageError("--period: the machines have periods of their own")
    return replace(
        plan,
        unload_accepting=plan.unload_accepting and not keep,
        wake=plan.wake and not no_wake,
        **{name: value for name, value in given.items() if value is not None},
    )


def _log() -> None:
    """Log messages of machines to standard output, warnings and errors to standard error."""
    messages, problems = logging.StreamHandler(sys.stdout), logging.StreamHandler(sys.stderr)
    messages.addFilter(lambda record: record.levelno < logging.WARNING)
    problems.setLevel(logging.WARNING)
    logging.basicConfig(level=logging.INFO, format="%(message)s", handlers=[messages, problems])


def _board(plan: Plan, board: str) -> str:
    """Return the whiteboard's name: the command line's if given, else the file's or the default."""
    source = click.get_current_context().get_parameter_source("board")
    given = source is click.core.ParameterSource.COMMANDLINE
    return board if given or plan.board is None else plan.board
