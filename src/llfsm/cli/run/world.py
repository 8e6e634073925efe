"""The world of the machines of ``llfsm run``: a whiteboard, a ROS graph, or both; and its recorder.

What is opened first is closed last: the whiteboard before the ROS node that at its end publishes
from it, and the whiteboard's removal after the recorder, which still reads it.

The recorder of ``--record`` is a process of its own. Machines hand their journal to it through the
whiteboard and never wait for it. If the recorder dies, they go on; if they are killed, it completes
its file. One that runs already is used without ``--record``.
"""

from __future__ import annotations

import logging
import os
import subprocess
import sys
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import click

from llfsm.bridges.ros2.bridging.bridge_plan import BridgePlan
from llfsm.bridges.ros2.bridging.machine_config import machine_config
from llfsm.bridges.ros2.bridging.managed_machines import ManagedMachines
from llfsm.bridges.ros2.bridging.ros_environment import RosEnvironment
from llfsm.bridges.ros2.node_parameters import NodeParameters
from llfsm.bridges.ros2.standard_node import equip
from llfsm.bridges.ros2.threads import TimerThread
from llfsm.bridges.ros2.transport import Transport
from llfsm.bridges.ros2.types import TypeLibrary
from llfsm.cli.bridge.configured import Configured, slots_on
from llfsm.cli.console import ignore_interrupts, stop_for_good
from llfsm.cli.echo import echo
from llfsm.cli.options import BoardPlace
from llfsm.cli.ros_options import GraphOptions, ros_arguments
from llfsm.runtime.engine.arrangement import Arrangement
from llfsm.runtime.engine.clock import Clock, DebugClock, SimulatedClock
from llfsm.runtime.engine.environment import Environment
from llfsm.runtime.engine.machine import Machine
from llfsm.runtime.engine.realtime import StopRequest, stop_on_signals
from llfsm.runtime.journal.handover import HANDOVER_LIMIT, Handover, find_recorder
from llfsm.runtime.journal.journalled import JournalledEnvironment
from llfsm.runtime.log import logger
from llfsm.runtime.plans import Plan
from llfsm.runtime.presence.live import LiveEnvironment
from llfsm.whiteboard import Board, Whiteboard, WhiteboardError
from llfsm.whiteboard.liveness import process_text

MakeEnvironment: TypeAlias = Callable[..., LiveEnvironment]


@contextmanager
def recorded(
    file: Path | None,
    board: Whiteboard,
    plan: Plan,
    clock: Clock | None = None,
    live: MakeEnvironment = LiveEnvironment,
    *,
    in_parts: bool = False,
    limit: int = HANDOVER_LIMIT,
    patience_s: float = 5.0,
) -> Iterator[Environment]:
    """Open the environment of an arrangement on `board`, journalled if a process records the board.

    `live` makes it from the board, the clock and the options of `LiveEnvironment`.

    With `file`, a recorder that writes it is started; it ends with the ``with`` block. If the
    arrangement runs `in_parts`, only the events of this one are recorded. `limit` bytes are kept
    for a recorder that stalls; at the end it has `patience_s` seconds to take each part of them and
    to complete the file. Raise ``click.ClickException`` if recording is impossible.
    """

    def journalled() -> Environment:
        if (recorder := find_recorder(board)) is None:
            raise click.ClickException("the recorder does not record machines, nothing was run")
        handover = Handover(board, recorder, whole=True, limit=limit, patience_s=patience_s)
        handover.journal.add(("Plan", plan, str(Path.cwd())))
        world = live(board, clock, handover=handover, will_after_ms=plan.will_after_ms)
        return JournalledEnvironment(world, handover.journal)

    recorder = find_recorder(board)
    if file is not None:
        if recorder is not None:
            process = process_text(recorder, "process")
            raise click.ClickException(
                f"{process} records the machines of {board.name!r} already: "
                f"end it, or leave out --record; nothing was run"
            )
        with _recorder(file, board, patience_s):
            yield journalled()
        return
    environment: Environment | None = None
    if recorder is not None and not in_parts:
        try:
            environment = journalled()
        except WhiteboardError as error:  # another's recording is no reason not to run
            logger().warning("the machines go on unrecorded: %s", error)
    yield environment or live(board, clock, will_after_ms=plan.will_after_ms)


@contextmanager
def _recorder(file: Path, board: Whiteboard, patience_s: float) -> Iterator[None]:
    """Record the board by another process, which ends when our end of its input is closed."""
    process = subprocess.Popen(
        [
            *(sys.executable, "-m", "llfsm.cli", "record", "--until-eof"),
            *("-o", str(file)),
            *BoardPlace(board.name, str(board.path.parent)).arguments,
        ],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        start_new_session=True,  # Ctrl-C ends the machines, and it has to record their last events
    )
    assert process.stdin is not None
    assert process.stdout is not None
    try:
        with process.stdout as output:
            if not output.readline():
                raise click.ClickException("the recorder did not start, nothing was run")
        yield
    finally:
        process.stdin.close()
        try:
            process.wait(patience_s)
        except subprocess.TimeoutExpired:
            process.kill()  # the file can be read as it is
            process.wait()


class RosOptions(NamedTuple):
    """The options ``--ros``, ``--ros-time`` and those that belong to them, by their names."""

    ros: bool
    ros_time: bool  # if the machines run by the time on /clock
    lifecycle: bool
    config: Path | None
    node: str | None
    graph: GraphOptions


class WorldOptions(NamedTuple):
    """The options for where machines run, and where this is recorded."""

    place: BoardPlace | None  # the shared whiteboard, if there is one
    local: bool
    remove_board: bool
    recording: Path | None
    in_parts: bool  # started again where an earlier run ended, or as it began
    ros: RosOptions | None


class OpenedWorld(NamedTuple):
    """An environment, and the names of its parts for the header that is printed."""

    environment: Environment
    names: list[str]


@contextmanager
def open_world(
    options: WorldOptions, plan: Plan, classes: Collection[type[Machine]]
) -> Iterator[OpenedWorld]:
    """Open the world of a plan, whose classes are in its order, for the ``with`` block."""
    ros, place = options.ros, options.place
    is_managed = ros is not None and ros.lifecycle
    clock: Clock | None = DebugClock() if plan.debug_clock else None
    live: MakeEnvironment = LiveEnvironment
    with ExitStack() as stack:
        if ros is not None:
            graph = stack.enter_context(join_graph(ros, plan, classes, place))
            clock = graph.clock or clock
        if options.local:
            local = stack.enter_context(Whiteboard.local())
            yield OpenedWorld(live(local, clock), ["a whiteboard of this process"])
            return
        names = [] if place is None else [f"whiteboard {place.name}"]
        # Before what connects it with ROS, which at the end publishes what is on it.
        wb = None if place is None else stack.enter_context(place.open())
        removal = stack.enter_context(ExitStack())
        if ros is not None and graph.connected is not None:
            live = stack.enter_context(
                on_ros(graph.transport, graph.connected, begin=not is_managed)
            )
            names.append(f"ROS domain {graph.transport.domain} as {graph.connected.node.full_node}")
        if wb is None or is_managed:
            environment: Environment = live(wb, clock)
        else:
            environment = stack.enter_context(
                recorded(options.recording, wb, plan, clock, live, in_parts=options.in_parts)
            )
        if wb is not None and options.remove_board:
            removal.callback(wb.remove)
        yield OpenedWorld(environment, names)


_LOOK_S = 0.25  # between two looks for Ctrl-C


class JoinedGraph(NamedTuple):
    """A ROS graph, and the parts of it that machines use."""

    transport: Transport
    connected: BridgePlan | None  # the relays between the machines and it, if they are a node
    clock: Clock | None  # the time on /clock, if they run by it


@contextmanager
def join_graph(
    options: RosOptions, plan: Plan, classes: Iterable[type[Machine]], place: BoardPlace | None
) -> Iterator[JoinedGraph]:
    """Open the graph that the options name; wait until /clock has a time if that is needed."""
    connected = _connections(options, plan, classes, place) if options.ros else None
    follows_time = options.ros_time or (connected is not None and _uses_simulated_time(connected))
    if follows_time and plan.debug_clock:
        raise click.UsageError("the time on /clock passes with its publisher: no --debug-clock")
    with ExitStack() as stack:
        transport = stack.enter_context(options.graph.open(ros_arguments().enclave))
        clock = stack.enter_context(_ros_clock(transport)) if follows_time else None
        yield JoinedGraph(transport, connected, clock)


def _connections(
    options: RosOptions, plan: Plan, classes: Iterable[type[Machine]], place: BoardPlace | None
) -> BridgePlan:
    """Plan the relays between machines and ROS, by default of each slot with its topic."""
    if options.config is None:
        slots = [machine.slots for machine in plan.machines]
        configured = Configured(machine_config(zip(classes, slots, strict=True)))
    else:
        configured = Configured.read(options.config)
    on_board = [] if place is None else slots_on(place)
    return configured.named(options.node).plan(on_board, ros_arguments())


def _uses_simulated_time(connected: BridgePlan) -> bool:
    """Read the node's parameter ``use_sim_time`` as it is at the start."""
    given = connected.arguments.parameters(connected.node.full_node)
    return given.get("use_sim_time") is True


@contextmanager
def _ros_clock(transport: Transport) -> Iterator[SimulatedClock]:
    """Open a clock that follows /clock, once there is a time, for the ``with`` block."""
    clock = SimulatedClock()
    with (
        closing(TimerThread("ros2 parameters")) as timer,
        transport.node(f"llfsm_run_{os.getpid()}") as node,
    ):
        equip(node, TypeLibrary(), NodeParameters(), timer.call_soon, clock.set_ns)
        if not clock.wait_set(_LOOK_S):
            echo("waiting for a time on /clock", err=True)
            with _ending_as_a_run() as asked:
                while not (clock.wait_set(_LOOK_S) or asked.is_made()):
                    pass
        yield clock


@contextmanager
def _ending_as_a_run() -> Iterator[StopRequest]:
    """Let Ctrl-C end the program after the block, as it ends a run."""
    asked = StopRequest()
    with stop_on_signals(lambda _: asked.make()):
        yield asked
    if asked.is_made():
        raise SystemExit(0)


@contextmanager
def on_ros(
    transport: Transport, connected: BridgePlan, *, begin: bool
) -> Iterator[MakeEnvironment]:
    """Give a function that makes the machines' environment, which is closed after the block.

    If they are to `begin` at once, the environment is made when their topics have subscriptions,
    or after a second: a command that is posted once reaches the robot.
    """
    logging.getLogger().setLevel(ros_arguments().log_level(connected.node.full_node))
    with ExitStack() as stack:

        def make(board: Board | None, clock: Clock | None, **options: Any) -> RosEnvironment:
            made = stack.enter_context(
                RosEnvironment(transport, connected, board=board, clock=clock, **options)
            )
            if begin:
                with _ending_as_a_run():
                    made.wait_subscribed()
            return made

        yield make


def managed_machines(
    world: Environment, load: Callable[[Environment], Arrangement], will_after_ms: int | None
) -> Callable[[], None]:
    """Return a function that runs machines as a managed node, which may `load` them repeatedly."""
    assert isinstance(world, RosEnvironment)
    board, clock, bridge = world.whiteboard, world.clock, world.bridge

    def loaded() -> Arrangement:
        return load(LiveEnvironment(board, clock, will_after_ms=will_after_ms))

    machines = ManagedMachines(bridge.node, bridge.types, loaded)
    stop_for_good(machines.stop)

    def run() -> None:
        machines.run()
        ignore_interrupts()

    return run
