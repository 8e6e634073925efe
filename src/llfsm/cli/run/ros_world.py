"""``llfsm run --ros`` and ``--ros-time``: machines that are a ROS node, or run by its time."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, closing, contextmanager
from typing import Any, NamedTuple

import click

from llfsm.bridges.ros2.bridging.bridge_plan import BridgePlan
from llfsm.bridges.ros2.bridging.machine_config import machine_config
from llfsm.bridges.ros2.bridging.managed_machines import ManagedMachines
from llfsm.bridges.ros2.bridging.ros_environment import RosEnvironment
from llfsm.bridges.ros2.node_parameters import NodeParameters
from llfsm.bridges.ros2.standard_node import equip
from llfsm.bridges.ros2.timer_thread import TimerThread
from llfsm.bridges.ros2.transport import Transport
from llfsm.bridges.ros2.types import TypeLibrary
from llfsm.runtime.engine.arrangement import Arrangement
from llfsm.runtime.engine.clock import Clock, SimulatedClock
from llfsm.runtime.engine.environment import Environment
from llfsm.runtime.engine.machine import Machine
from llfsm.runtime.engine.signals import StopRequest, stop_on_signals
from llfsm.runtime.plans.plan import Plan
from llfsm.runtime.presence.live import LiveEnvironment
from llfsm.whiteboard import Board

from ..bridge.configured import Configured, slots_on
from ..ending import ignore_interrupts, stop_for_good
from ..options import BoardPlace
from ..ros_options import open_chosen, ros_arguments
from .recorder_process import MakeEnvironment
from .world import RosOptions

__all__ = ["JoinedGraph", "join_graph", "managed_machines", "on_ros"]

_LOOK_S = 0.25  # between two looks for Ctrl-C


class JoinedGraph(NamedTuple):
    """A ROS graph, and what machines use of it."""

    transport: Transport
    connected: BridgePlan | None
    """What connects the machines with it, if they are a node."""
    clock: Clock | None
    """The time on /clock, if they run by it."""


@contextmanager
def join_graph(
    options: RosOptions, plan: Plan, classes: Iterable[type[Machine]], place: BoardPlace | None
) -> Iterator[JoinedGraph]:
    """Give the graph that the options name, once /clock has a time if it is needed.

    `place` is the shared whiteboard, if there is one. Raise ``click.ClickException``.
    """
    connected = _connections(options, plan, classes, place) if options.is_node else None
    follows_time = options.follows_time or (
        connected is not None and _uses_simulated_time(connected)
    )
    if follows_time and plan.debug_clock:
        raise click.UsageError("the time on /clock passes with its publisher: no --debug-clock")
    enclave = ros_arguments().enclave
    with ExitStack() as stack:
        transport = stack.enter_context(
            open_chosen(options.transport, options.domain, options.router, enclave)
        )
        clock = stack.enter_context(_ros_clock(transport)) if follows_time else None
        yield JoinedGraph(transport, connected, clock)


def _connections(
    options: RosOptions, plan: Plan, classes: Iterable[type[Machine]], place: BoardPlace | None
) -> BridgePlan:
    """Return what connects the machines of a plan, whose classes are in its order, with ROS.

    By default it is the topics of their slots' names.
    """
    if options.config is None:
        slots = [machine.slots for machine in plan.machines]
        configured = Configured(machine_config(zip(classes, slots, strict=True)))
    else:
        configured = Configured.read(options.config)
    on_board = [] if place is None else slots_on(place)
    return configured.named(options.node).plan(on_board, ros_arguments())


def _uses_simulated_time(connected: BridgePlan) -> bool:
    """Return whether the node's parameter says at the start that its time is that of /clock."""
    given = connected.arguments.parameters(connected.node.full_node)
    return given.get("use_sim_time") is True


@contextmanager
def _ros_clock(transport: Transport) -> Iterator[SimulatedClock]:
    """Give a clock that follows /clock, once there is a time, within the ``with`` block."""
    clock = SimulatedClock()
    with (
        closing(TimerThread("ros2 parameters")) as timer,
        transport.node(f"llfsm_run_{os.getpid()}") as node,
    ):
        equip(node, TypeLibrary(), NodeParameters(), timer.call_soon, clock.set_ns)
        if not clock.wait_set(_LOOK_S):
            _wait_set(clock)
        yield clock


def _wait_set(clock: SimulatedClock) -> None:
    """Wait for the first time; Ctrl-C ends the program as it ends a run."""
    click.echo("waiting for a time on /clock", err=True)
    asked = StopRequest()
    with stop_on_signals(lambda _: asked.make()):
        while not clock.wait_set(_LOOK_S):
            if asked.is_made():
                raise SystemExit(0)


@contextmanager
def on_ros(
    transport: Transport, connected: BridgePlan, *, begin: bool
) -> Iterator[MakeEnvironment]:
    """Give what makes the machines' environment, which is closed after the ``with`` block.

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
                _wait_subscribed(made)
            return made

        yield make


def _wait_subscribed(environment: RosEnvironment) -> None:
    """Wait; Ctrl-C ends the program as it ends a run."""
    asked = StopRequest()
    with stop_on_signals(lambda _: asked.make()):
        environment.wait_subscribed()
    if asked.is_made():
        raise SystemExit(0)


def managed_machines(
    world: Environment, load: Callable[[Environment], Arrangement], will_after_ms: int | None
) -> Callable[[], None]:
    """Return what runs machines as a managed node, until SIGINT or SIGTERM; `load` loads them."""
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
