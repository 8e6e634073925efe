"""``llfsm run``: machines as one arrangement, with clfsm's options."""

from __future__ import annotations

import os
from functools import partial
from pathlib import Path
from typing import Any

import click
from msgspec.structs import replace

from llfsm.cli import VERSION
from llfsm.cli.console import log_machines
from llfsm.cli.echo import echo
from llfsm.cli.machines import parse_arguments
from llfsm.cli.options import (
    BoardPlace,
    Integer,
    Number,
    board_option,
    break_option,
    end_with_input,
    file_option,
    given_option,
    local_option,
    record_option,
    supervised_options,
)
from llfsm.cli.ros_options import RosCommand, require_ros, ros_arguments, ros_options
from llfsm.cli.run.running import Reports, load_machines, run_machines, run_nonstop
from llfsm.cli.run.world import RosOptions, WorldOptions, managed_machines, open_world
from llfsm.runtime.plans import Plan


class _Priority(Integer):
    """A priority that may be left out: the next word is then an option, or the end."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the number; refuse a word, which is probably the machine that was to run."""
        if isinstance(value, str) and not value.lstrip("-").isdigit():
            self.fail(f"{value!r} is not a priority; name the machines first", param, ctx)
        return super().convert(value, param, ctx)


class _Run(RosCommand):
    """The command, whose help shows the options that most need; ``--help-all`` shows all."""

    _FIRST = (
        *("verbose", "timed", "quiet", "period_us", "on_error"),
        *("recording", "kept", "ros", "board", "local"),
    )

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the help of the options."""
        if ctx.meta.get(_ALL):
            super().format_options(ctx, formatter)
            return
        *parameters, this_help = self.get_params(ctx)
        by_name = {parameter.name: parameter for parameter in parameters}
        shown = [*(by_name[name] for name in (*self._FIRST, "help_all")), this_help]
        with formatter.section("Options"):
            formatter.write_dl(list(filter(None, (each.get_help_record(ctx) for each in shown))))


_ALL = "llfsm.run.all"  # in the context, if the help is to show all options


def _help_all(ctx: click.Context, _: click.Parameter, is_asked: bool) -> None:
    if is_asked:
        ctx.meta[_ALL] = True
        echo(ctx.get_help())
        ctx.exit()


@click.command(cls=_Run)
@click.option(
    "--help-all",
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=_help_all,
    help="Show all options.",
)
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
    help="Print state changes: machine number, state number, machine, state; -vv adds its path.",
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
    type=Integer(0),
    help="Sleep this many microseconds (default 10000) after a round in which no transition fired.",
)
@click.option(
    "--no-wake",
    is_flag=True,
    help="Always sleep to the end, as clfsm does; else a new message for a machine ends the sleep.",
)
@click.option(
    "--period",
    "period_us",
    metavar="US",
    type=Integer(1),
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
    type=Integer(1),
    help="Report machine code that runs longer than MS milliseconds, and post its safe values.",
)
@click.option(
    "--realtime",
    metavar="[PRIORITY]",
    type=_Priority(1, 99),
    is_flag=False,
    flag_value=50,
    help="Run at this SCHED_FIFO priority (default 50) with locked memory; an error if forbidden.",
)
@click.option("--cpu", metavar="N", type=Integer(0), help="With --realtime: run only on core N.")
@click.option(
    "--grace",
    "grace_s",
    metavar="SECONDS",
    type=Number(0),
    help="After Ctrl-C, the time for machines to reach accepting states; by default 1.",
)
@click.option(
    "--will-after",
    "will_after_ms",
    metavar="MS",
    type=Integer(500),
    help="Let guards also post the safe values if this process is silent for MS milliseconds.",
)
@file_option(
    "--keep",
    "kept",
    help="Keep the machines' states in FILE, and go on there when started again.",
)
@break_option
@click.option(
    "--on-pause",
    type=click.Choice(["keep", "safe"]),
    help="When paused: keep what was posted (the default), or post the safe values.",
)
@click.option(
    "--debug-clock", is_flag=True, help="Let the states' clocks stand still while paused."
)
@record_option
@click.option(
    "--ros-time",
    is_flag=True,
    help="Run by the time on ROS's /clock, which a simulator or `ros2 bag play --clock` publishes.",
)
@click.option(
    "--ros",
    is_flag=True,
    help="Run as a ROS node: sensors and actuators are topics, and a whiteboard is used if named.",
)
@file_option(
    "--config",
    help="With --ros: what to connect, as for `llfsm bridge ros2`; by default topics named as "
    "the machines' slots.",
)
@click.option("--node", metavar="NAME", help="With --ros: the node's name.")
@click.option(
    "--lifecycle",
    is_flag=True,
    help="With --ros: run as a managed node, whose lifecycle others control.",
)
@ros_options(" (with --ros or --ros-time)")
@board_option
@local_option
@supervised_options
def run(
    machines: tuple[str, ...],
    suspended: tuple[str, ...],
    preloaded: tuple[str, ...],
    table: Path | None,
    nonstop: bool,
    quiet: bool,
    recording: Path | None,
    kept: Path | None,
    board: BoardPlace,
    local: bool,
    remove_board: bool,
    **given: Any,
) -> None:
    """Run MACHINES, in this order, until all accept or are suspended, or Ctrl-C.

    A machine is one that ships, patrol.py:Patrol, or the folder of a bundle; name=machine
    gives it a name, name:variable=value sets a variable, and name:slot:=other replaces a slot.
    Instead of machines, name an arrangement file (.toml).

    \b
    llfsm run RosPingPong -v
    llfsm run path/to/Patrol.machine
    llfsm run RosBlindTurttleBot TurtleSuspendResume -s
    llfsm run a=my_robot.patrol:Patrol a:rounds=3 a:turtle1/pose:=bob/pose
    llfsm run robot.toml -t
    llfsm run RosPingPong -v --local
    llfsm run --ros patrol.py:Patrol --ros-args -r __ns:=/robot
    """
    _check_options(**click.get_current_context().params)
    resolved = parse_arguments(machines, table, suspended, preloaded)
    ros = RosOptions(*map(given.pop, RosOptions._fields))
    reports = Reports(*map(given.pop, Reports._fields))
    plan = resolved.plan = _with_options(resolved.plan, **given)
    place = None if local else _place(plan, board, default=not ros.ros)
    if recording is not None and place is None:
        raise click.UsageError(
            "--record with --ros needs a whiteboard for the recorder: add --board"
        )
    joined = ros if ros.ros or ros.ros_time else None
    in_parts = nonstop or kept is not None  # no recording has what came before
    options = WorldOptions(place, local, remove_board, recording, in_parts, joined)
    log_machines(is_on=not ros.ros or ros_arguments().stdout)
    with open_world(options, plan, resolved.classes.values()) as world:
        load = partial(load_machines, resolved, reports)
        if ros.lifecycle:
            execute = managed_machines(world.environment, load, plan.will_after_ms)
        else:
            arrangement = load(world.environment)
            execute = partial(
                run_machines, arrangement, timed=reports.timed, kept=kept, quiet=quiet
            )
        if not quiet:
            names = ", ".join(resolved.classes)
            echo(f"llfsm {VERSION}: {names} on {', '.join(world.names)}", err=True)
        end_with_input()
        if nonstop:
            run_nonstop(execute, arrangement.stop)
        else:
            execute()


def _check_options(
    *,
    nonstop: bool,
    local: bool,
    ros: bool,
    ros_time: bool,
    lifecycle: bool,
    recording: Path | None,
    kept: Path | None,
    **_: object,
) -> None:
    """Refuse options that do not go together."""
    if nonstop and recording is not None:
        raise click.UsageError("--record keeps one run, -n may start several: leave out one")
    if nonstop and (ros or ros_time):
        raise click.UsageError(
            "--ros and --ros-time keep a connection that -n cannot: leave it out"
        )
    shared = local and given_option(
        "ros", "recording", "will_after_ms", "board", "directory", "remove_board"
    )
    if shared:
        raise click.UsageError(f"--local shares nothing with other processes: leave out {shared}")
    if nonstop and not hasattr(os, "fork"):
        raise click.UsageError("-n needs the fork of Linux or macOS: leave it out")
    require_ros("config", "node", "lifecycle", ros=ros)
    require_ros("transport", "domain", "router", ros=ros or ros_time, by="--ros or --ros-time")
    if lifecycle and recording is not None:
        raise click.UsageError("--record keeps one run, --lifecycle may start several")
    if kept is not None and lifecycle:
        raise click.UsageError("--keep keeps one run, --lifecycle may start several")


def _with_options(
    plan: Plan,
    *,
    keep: bool,
    no_wake: bool,
    breakpoints: tuple[str, ...],
    debug_clock: bool,
    **given: object,
) -> Plan:
    """Override a plan by the options of the command line that are given."""
    if given["period_us"] is not None and any(machine.period_us for machine in plan.machines):
        raise click.UsageError("--period: the machines have periods of their own")
    return replace(
        plan,
        unload_accepting=plan.unload_accepting and not keep,
        wake=plan.wake and not no_wake,
        breakpoints=breakpoints or plan.breakpoints,
        debug_clock=debug_clock or plan.debug_clock,
        **{name: value for name, value in given.items() if value is not None},
    )


def _place(plan: Plan, board: BoardPlace, *, default: bool) -> BoardPlace | None:
    """Choose the whiteboard: the command line's if named, else the file's, else a `default` one."""
    given = given_option("board") is not None
    if given or plan.board is None:
        return board if given or default else None
    return board._replace(name=plan.board)
