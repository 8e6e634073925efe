"""The world of the machines of ``llfsm run``: a whiteboard, a ROS graph, or both."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import NamedTuple

from llfsm.runtime.engine.clock import Clock, DebugClock
from llfsm.runtime.engine.environment import Environment
from llfsm.runtime.engine.machine import Machine
from llfsm.runtime.plans.plan import Plan
from llfsm.runtime.presence.live import LiveEnvironment
from llfsm.whiteboard import Whiteboard

from ..options import BoardPlace
from .recorder_process import MakeEnvironment, recorded

__all__ = ["OpenedWorld", "RosOptions", "WorldOptions", "open_world"]


class RosOptions(NamedTuple):
    """Which ROS graph to join, and as what."""

    is_node: bool
    follows_time: bool
    """Whether the machines run by the time on /clock."""
    is_managed: bool
    config: Path | None
    node: str | None
    transport: str
    domain: int | None
    router: tuple[str, ...]


class WorldOptions(NamedTuple):
    """Where machines run, and where this is recorded."""

    place: BoardPlace | None
    """The shared whiteboard, if there is one."""
    local: bool
    remove_board: bool
    recording: Path | None
    forks: bool
    ros: RosOptions | None


class OpenedWorld(NamedTuple):
    """An environment, and the names of what it consists of."""

    environment: Environment
    names: list[str]


@contextmanager
def open_world(
    options: WorldOptions, plan: Plan, classes: Collection[type[Machine]]
) -> Iterator[OpenedWorld]:
    """Give the world of a plan, whose classes are in its order, within the ``with`` block.

    Raise ``click.ClickException``.
    """
    ros, place = options.ros, options.place
    is_managed = ros is not None and ros.is_managed
    clock: Clock | None = DebugClock() if plan.debug_clock else None
    live: MakeEnvironment = LiveEnvironment
    with ExitStack() as stack:
        if ros is not None:
            from .ros_world import join_graph, on_ros  # here, as few machines need ROS

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
                recorded(options.recording, wb, plan, clock, live, forks=options.forks)
            )
        if wb is not None and options.remove_board:
            removal.callback(wb.remove)
        yield OpenedWorld(environment, names)
