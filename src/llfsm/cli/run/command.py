"""``llfsm run``: machines as one arrangement, with clfsm's options."""

from __future__ import annotations

import logging
import os
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any, Literal

import click
from msgspec.structs import replace

from llfsm.runtime.engine.clock import Clock, DebugClock
from llfsm.runtime.engine.environment import Environment
from llfsm.runtime.plans.plan import Plan
from llfsm.runtime.presence.live import LiveEnvironment
from llfsm.whiteboard import Whiteboard

from .. import VERSION
from ..ending import ignore_interrupts
from ..numbers import Integer
from ..options import (
    BoardPlace,
    board_option,
    break_option,
    end_with_input,
    given_option,
    local_option,
    supervised_options,
)
from ..ros_options import RosCommand, open_chosen, require_ros, ros_arguments, ros_options
from .arguments import parse_arguments
from .nonstop import run_nonstop
from .recorder_process import MakeEnvironment, recorded
from .report import log_machines
from .running import Reports, load_machines, run_machines

__all__ = ["run"]


class _Priority(Integer):
    """A priority that may be left out, if no machine follows."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the number; a word is probably the machine that was to run."""
        if isinstance(value, str) and not value.lstrip("-").isdigit():
            self.fail(f"{value!r} is not a priority; name the machines first", param, ctx)
        return super().convert(value, param, ctx)


@click.command(cls=RosCommand)
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
    type=Integer(0),
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
@click.option("--cpu", metavar="N", type=Integer(0), help="With --realtime: run on core N alone.")
@click.option(
    "--will-after",
    "will_after_ms",
    metavar="MS",
    type=Integer(500),
    help="Let guards post the safe values also if this process is silent for MS milliseconds.",
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
@click.option(
    "--record",
    "recording",
    metavar="FILE",
    type=click.Path(path_type=Path),
    help="Record the whiteboard and all that the machines do, for llfsm rerun.",
)
@click.option(
    "--ros-time",
    is_flag=True,
    help="Run by the time on ROS's /clock, which a simulator or `ros2 bag play --clock` publishes.",
)
@click.option(
    "--ros",
    is_flag=True,
    help="Be a ROS node: sensors and actuators are topics, and a whiteboard is used if named.",
)
@click.option(
    "--config",
    metavar="FILE",
    type=click.Path(path_type=Path),
    help="With --ros: what to connect, as for `llfsm bridge ros2`; by default topics named as "
    "the machines' slots.",
)
@click.option("--node", metavar="NAME", help="With --ros: the node's name.")
@click.option(
    "--lifecycle",
    is_flag=True,
    help="With --ros: be a managed node, whose lifecycle others control.",
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
    breakpoints: tuple[str, ...],
    on_pause: Literal["keep", "safe"] | None,
    debug_clock: bool,
    recording: Path | None,
    ros_time: bool,
    ros: bool,
    config: Path | None,
    node: str | None,
    lifecycle: bool,
    transport: str,
    domain: int | None,
    router: tuple[str, ...],
    board: BoardPlace,
    local: bool,
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
    llfsm run RosPingPong -v --local
    llfsm run --ros patrol.py:Patrol --ros-args -r __ns:=/robot
    """
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
        breakpoints=breakpoints or None,
        on_pause=on_pause,
        debug_clock=debug_clock or None,
    )
    place = None if local else _place(plan, board, default=not ros)
    if recording is not None and place is None:
        raise click.UsageError(
            "--record with --ros needs a whiteboard for the recorder: add --board"
        )
    log_machines(is_on=not ros or ros_arguments().stdout)
    where = ["a whiteboard of this process"] if local else []
    if place is not None:
        where.append(f"whiteboard {place.name}")
    with ExitStack() as stack:
        clock: Clock | None = DebugClock() if plan.debug_clock else None
        live: MakeEnvironment = LiveEnvironment
        if ros:
            # here, as few machines need ROS
            from .ros_world import connections, on_ros, uses_simulated_time

            connected = connections(plan, resolved.classes.values(), config, node, place)
            ros_time = ros_time or uses_simulated_time(connected)
        if ros_time and plan.debug_clock:
            raise click.UsageError("the time on /clock passes with its publisher: no --debug-clock")
        if ros or ros_time:
            enclave = ros_arguments().enclave
            opened = stack.enter_context(open_chosen(transport, domain, router, enclave))
        if ros_time:
            from .ros_time import ros_clock

            clock = stack.enter_context(ros_clock(opened))
        # Before what connects it with ROS, which at the end publishes what is on it.
        wb = None if place is None else stack.enter_context(place.open())
        removal = stack.enter_context(ExitStack())
        if ros:
            logging.getLogger().setLevel(ros_arguments().log_level(connected.node.full_node))
            live = stack.enter_context(on_ros(opened, connected, begin=not lifecycle))
            where.append(f"ROS domain {opened.domain} as {connected.node.full_node}")
        if local:
            environment: Environment = live(stack.enter_context(Whiteboard.local()), clock)
        elif wb is None or lifecycle:
            environment = live(wb, clock)
        else:
            environment = stack.enter_context(
                recorded(recording, wb, plan, clock, live, forks=nonstop)
            )
        if wb is not None and remove_board:
            removal.callback(wb.remove)

        load = partial(load_machines, resolved, plan, Reports(verbose, report, timed))
        if lifecycle:
            from .ros_world import managed_machines

            managed = managed_machines(environment, load, plan.will_after_ms)
        arrangement = None if lifecycle else load(environment)
        if not quiet:
            names = ", ".join(resolved.classes)
            click.echo(f"llfsm {VERSION}: {names} on {', '.join(where)}", err=True)
        if until_eof:
            end_with_input()
        if arrangement is None:
            managed.run()
            ignore_interrupts()
            return

        execute = partial(run_machines, arrangement, timed=timed)
        if nonstop:
            run_nonstop(execute, arrangement.stop)
        else:
            execute()


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


def _place(plan: Plan, board: BoardPlace, *, default: bool) -> BoardPlace | None:
    """Return the whiteboard with the command line's name if given, else the file's or default.

    If none is named and no default one is wanted, return None.
    """
    given = given_option("board") is not None
    if given or plan.board is None:
        return board if given or default else None
    return board._replace(name=plan.board)
