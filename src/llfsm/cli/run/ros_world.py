"""``llfsm run --ros``: machines that are a ROS node themselves."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from llfsm.bridges.ros2.bridging.bridge_plan import BridgePlan
from llfsm.bridges.ros2.bridging.machine_config import machine_config
from llfsm.bridges.ros2.bridging.managed_machines import ManagedMachines
from llfsm.bridges.ros2.bridging.ros_environment import RosEnvironment
from llfsm.bridges.ros2.transport import Transport
from llfsm.runtime.engine.arrangement import Arrangement
from llfsm.runtime.engine.clock import Clock
from llfsm.runtime.engine.environment import Environment
from llfsm.runtime.engine.machine import Machine
from llfsm.runtime.engine.signals import StopRequest, stop_on_signals
from llfsm.runtime.plans.plan import Plan
from llfsm.runtime.presence.live import LiveEnvironment
from llfsm.whiteboard import Board

from ..bridge.configured import Configured, slots_on
from ..ending import stop_for_good
from ..options import BoardPlace
from ..ros_options import ros_arguments
from .recorder_process import MakeEnvironment

__all__ = ["connections", "managed_machines", "on_ros", "uses_simulated_time"]


def connections(
    plan: Plan,
    classes: Iterable[type[Machine]],
    config: Path | None,
    node: str | None,
    place: BoardPlace | None,
) -> BridgePlan:
    """Return what connects the machines of a plan, whose classes are in its order, with ROS.

    By default it is the topics of their slots' names. `place` is the shared whiteboard, if there is
    one. Raise ``click.ClickException``.
    """
    if config is None:
        slots = [machine.slots for machine in plan.machines]
        configured = Configured(machine_config(zip(classes, slots, strict=True)))
    else:
        configured = Configured.read(config)
    on_board = [] if place is None else slots_on(place)
    return configured.named(node).plan(on_board, ros_arguments())


def uses_simulated_time(connected: BridgePlan) -> bool:
    """Return whether the node's parameter says at the start that its time is that of /clock."""
    given = connected.arguments.parameters(connected.node.full_node)
    return given.get("use_sim_time") is True


@contextmanager
def on_ros(
    transport: Transport, connected: BridgePlan, *, begin: bool
) -> Iterator[MakeEnvironment]:
    """Give what makes the machines' environment, which is closed after the ``with`` block.

    If they are to `begin` at once, the environment is made when their topics have subscriptions,
    or after a second: a command that is posted once reaches the robot.
    """
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
) -> ManagedMachines:
    """Return machines as a managed node, which SIGINT and SIGTERM end; `load` loads them."""
    assert isinstance(world, RosEnvironment)
    board, clock, bridge = world.whiteboard, world.clock, world.bridge

    def loaded() -> Arrangement:
        return load(LiveEnvironment(board, clock, will_after_ms=will_after_ms))

    machines = ManagedMachines(bridge.node, bridge.types, loaded)
    stop_for_good(machines.stop)
    return machines
