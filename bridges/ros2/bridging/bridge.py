"""A running bridge: the links of a plan between a board and a transport, and their health.

The health of the links, and of the machines on the whiteboard, is on /diagnostics once a second, as
diagnostic_updater publishes it.
"""

from __future__ import annotations

import logging
import os
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from enum import IntEnum
from itertools import chain
from typing import Any, NamedTuple, Protocol

from llfsm.bridges.ros2.bridging._relays import (
    EchoFilter,
    FromRos,
    KeyedFromRos,
    LatestArrival,
    LossWatch,
    RelaySettings,
    ToRos,
    declare_settings,
)
from llfsm.bridges.ros2.bridging._slot_action import ActionPlace, SlotActionClient, SlotActionServer
from llfsm.bridges.ros2.bridging._slot_service import SlotClient, SlotServer
from llfsm.bridges.ros2.bridging._turtle_position import NODE, SERVICE, PositionServer
from llfsm.bridges.ros2.bridging.bridge_config import KeyPath
from llfsm.bridges.ros2.bridging.bridge_plan import (
    BridgePlan,
    PositionPlan,
    RelayPlan,
    ServicePlan,
)
from llfsm.bridges.ros2.bridging.link import BridgeLink
from llfsm.bridges.ros2.errors import TransportClosedError, TransportUnavailableError
from llfsm.bridges.ros2.graph import Names
from llfsm.bridges.ros2.node_parameters import NodeParameters
from llfsm.bridges.ros2.node_time import NodeTime, from_ns
from llfsm.bridges.ros2.qos import DurabilityPolicy, Qos, overridden
from llfsm.bridges.ros2.standard_node import Equipment, equip
from llfsm.bridges.ros2.threads import TimerThread
from llfsm.bridges.ros2.transport import Node, Notice, Notifier, Transport, log_notice
from llfsm.bridges.ros2.types import TypeLibrary
from llfsm.runtime.presence.remote import Directory, RemoteMachine
from llfsm.whiteboard import Board, BoundSlot, WhiteboardError
from llfsm.whiteboard.liveness import writer_lives
from llfsm.whiteboard.messages.std_msgs import Header
from llfsm.whiteboard.messages.turtle_sensor_poster import ANSWER

_LOG = logging.getLogger("llfsm.bridges.ros2")

_PERIOD_S = 1.0


class HealthLevel(IntEnum):
    """The levels of diagnostic_msgs/msg/DiagnosticStatus, numbered as there."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


class Health(NamedTuple):
    """The health of one part of a node."""

    name: str
    level: HealthLevel
    message: str
    values: dict[str, str]


@dataclass(eq=False)
class Diagnostics:
    """Publishes what ``report`` returns, on the timer's thread, until the node is closed.

    ``now_ns`` returns the node's time, for stamps.
    """

    node: Node
    types: TypeLibrary
    report: Callable[[], Iterable[Health]]
    timer: TimerThread
    now_ns: Callable[[], int]

    def __post_init__(self) -> None:
        array = self.types.message("diagnostic_msgs/msg/DiagnosticArray")
        self._array = array.message
        self._status = self.types.message("diagnostic_msgs/msg/DiagnosticStatus").message
        self._value = self.types.message("diagnostic_msgs/msg/KeyValue").message
        self._publisher = self.node.publisher("/diagnostics", array, Qos(depth=1))
        self._later()

    def _later(self) -> None:
        self.timer.call_later(_PERIOD_S, self._publish)

    def _publish(self) -> None:
        if self._publisher.closed:
            return
        self._later()  # first: a report that fails is logged, and the next is published
        prefix = self.node.name.lstrip("/")
        statuses = tuple(
            self._status(
                level=int(each.level),
                name=f"{prefix}: {each.name}",
                message=each.message,
                values=tuple(self._value(*pair) for pair in each.values.items()),
            )
            for each in self.report()
        )
        with suppress(TransportClosedError):
            self._publisher.publish(self._array(Header(stamp=from_ns(self.now_ns())), statuses))


_OF_CONDITION = {
    "running": HealthLevel.OK,
    "suspended": HealthLevel.OK,
    "paused": HealthLevel.WARN,
    "failed": HealthLevel.ERROR,
    "hung": HealthLevel.ERROR,
    "silent": HealthLevel.STALE,
}


class BridgeHealth:
    """Reports rates and losses since the report before; call it on one thread."""

    def __init__(
        self, links: Sequence[BridgeLink], board: Board, now: Callable[[], float] = time.monotonic
    ) -> None:
        self._links = links
        self._machines = Directory(board)
        self._now = now
        self._then = now()
        self._before: dict[BridgeLink, tuple[int, int, int]] = {}
        self._ringlets: dict[str, int] = {}

    def report(self) -> list[Health]:
        """Measure the health of each link and of each machine."""
        now = self._now()
        seconds, self._then = max(now - self._then, 1e-9), now
        links = (self._of_link(link, seconds) for link in self._links)
        return list(chain(links, self._of_machines(seconds)))

    def _of_link(self, link: BridgeLink, seconds: float) -> Health:
        passed, failed, broken, age = link.passed, link.failed, link.broken, link.age
        then_passed, then_failed, then_broken = self._before.get(link, (0, 0, 0))
        self._before[link] = passed, failed, broken
        lost, late = failed - then_failed, broken - then_broken
        wrong = [f"{lost} lost"] * (lost > 0) + [f"{late} too late"] * (late > 0)
        return Health(
            str(link),
            HealthLevel.WARN if wrong else HealthLevel.OK,
            f"{', '.join(wrong)} since the last report" if wrong else "nothing lost",
            {
                "type": link.type_name,
                "rate (Hz)": f"{(passed - then_passed) / seconds:.1f}",
                "age (s)": "" if age is None else f"{age:.3f}",
                "passed": str(passed),
                "lost": str(failed),
                "too late": str(broken),
            },
        )

    def _of_machines(self, seconds: float) -> Iterator[Health]:
        try:
            machines = self._machines.machines()
        except WhiteboardError:  # the board has gone: so have its machines
            return
        then, self._ringlets = self._ringlets, {m.name: m.status.ringlets for m in machines}
        for machine in machines:
            turns = machine.status.ringlets - then.get(machine.name, machine.status.ringlets)
            yield _of_machine(machine, max(turns, 0) / seconds)


def _of_machine(machine: RemoteMachine, rate: float) -> Health:
    status, condition = machine.status, machine.condition
    return Health(
        f"machine {machine.name}",
        _OF_CONDITION[condition],
        f"{condition}: {status.error}" if status.error else condition,
        {
            "state": status.state,
            "rate (Hz)": f"{rate:.1f}",
            "age (s)": f"{machine.silent_s:.3f}",
            "overruns": str(status.overruns),
            "failed": str(status.failed),
        },
    )


_LOOK_S = 0.05  # nothing reports that a process has ended


class _Worker(Protocol):
    def finish(self) -> None: ...
    def close(self) -> None: ...


class Bridge:
    """Connects a board with a ROS graph until it is closed.

    The board and the transport stay open. It is a node with parameters for the rate of each relay
    and its switch.

    node: the node.
    types: the types that it knows.
    log: a handler that publishes what is logged on /rosout.
    """

    def __init__(
        self,
        plan: BridgePlan,
        board: Board,
        transport: Transport,
        notify: Callable[[Notice], None] = log_notice,
    ) -> None:
        """Start. ``notify`` gets the faults of links, each kind once for a link.

        Raise :class:`.SlotTypeError` if a slot was made with another type since
        the plan was made.
        """
        self.links: list[BridgeLink] = []
        self._board = board
        self._notifier = Notifier(notify)
        self._timer = TimerThread("bridge rates")
        self._workers: list[_Worker] = []
        self._to_ros: list[ToRos[Any]] = []
        self._goals: list[BoundSlot[Any]] = []  # and what cancels them
        self._nodes: list[Node] = []
        try:
            self._connect(plan, transport)
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """End all links, after publishing the messages that are on the slots by now."""
        for worker in self._workers:
            worker.finish()
        for worker in self._workers:
            worker.close()
        for node in self._nodes:
            node.close()
        self._timer.close()

    def linger(self, at_most: float = 1.5) -> None:
        """Give the programs that command robots through the bridge time to command a stop.

        It waits while a process lives that has added to a slot relayed to ROS, or has sent a goal,
        and ``at_most`` so many seconds: machines that are asked to stop have a grace period of one.
        That their board was removed asks them, too.
        """
        commanded = [*(relay.slot for relay in self._to_ros), *self._goals]
        until = time.monotonic() + at_most
        while time.monotonic() < until and any(map(_is_commanded, commanded)):
            time.sleep(_LOOK_S)  # nothing signals the end of another user's or parent's process

    def _connect(self, plan: BridgePlan, transport: Transport) -> None:
        names = plan.node
        parameters = NodeParameters()
        parameters.override(plan.arguments.parameters(names.full_node))
        settings = declare_settings(plan.relays, parameters)
        relays = [_overridden(relay, parameters) for relay in plan.relays]
        node, equipment = self._node(transport, names, plan.types, parameters)
        self.node, self.types, self.log = node, plan.types, equipment.log
        self._arrivals = _arrivals(relays)
        for relay, of_relay in zip(relays, settings, strict=True):
            self._relay(node, relay, of_relay)
        for client in plan.clients:
            self._client(node, client)
        for server in plan.servers:
            self._server(node, server)
        for action in plan.actions:
            self._action(node, action, plan.types, equipment.time)
        if plan.position:
            names = plan.arguments.names(NODE, only_one=False)
            parameters = NodeParameters()
            parameters.override(plan.arguments.parameters(names.full_node))
            position, _ = self._node(transport, names, plan.types, parameters)
            self._position(position, plan.position, names.full_service(SERVICE))
        try:
            health = BridgeHealth(self.links, self._board)
            Diagnostics(node, plan.types, health.report, self._timer, equipment.time.now_ns)
        except TransportUnavailableError as error:  # rclpy without diagnostic_msgs
            _LOG.warning("no /diagnostics: %s", error)

    def _node(
        self, transport: Transport, names: Names, types: TypeLibrary, parameters: NodeParameters
    ) -> tuple[Node, Equipment]:
        node = transport.node(names.node, names.namespace, names.remap)
        self._nodes.append(node)
        return node, equip(node, types, parameters, self._timer.call_soon)

    def _link(self, slot: str, arrow: str, name: str, type_name: str) -> BridgeLink:
        link = BridgeLink(slot, arrow, name, type_name, self._notifier)
        self.links.append(link)
        return link

    def _relay(self, node: Node, plan: RelayPlan, settings: RelaySettings) -> None:
        if plan.keys is not None:
            self._keyed_relay(node, plan, plan.keys, settings)
            return
        slot, echo, publisher = self._board[plan.slot], None, None
        arrival = self._arrivals.get(plan.slot.name)
        if plan.to_ros:
            publisher = node.publisher(plan.name, plan.of, plan.to_ros)
            if plan.from_ros:
                echo = EchoFilter(publisher, plan.of)
        if plan.from_ros:
            link = self._link(plan.slot.name, "<-", plan.topic, plan.of.name)
            relay = FromRos(slot, link, self._timer, settings=settings, echo=echo, latest=arrival)
            link.end = node.subscription(plan.name, plan.of, relay.arrived, plan.from_ros)
        if publisher is not None and plan.to_ros is not None:
            link = self._link(plan.slot.name, "->", plan.topic, plan.of.name)
            link.end = publisher
            to_ros = ToRos(
                slot,
                publisher,
                link,
                settings=settings,
                latched=plan.to_ros.durability is DurabilityPolicy.TRANSIENT_LOCAL,
                echo=echo,
                arrival=arrival if plan.from_ros is None else None,
            )
            if plan.at_loss is not None:
                self._workers.append(
                    LossWatch(
                        slot,
                        plan.at_loss,
                        plan.slot.encoder.encode(plan.at_loss),
                        link,
                        self._timer,
                    )
                )
            self._to_ros.append(to_ros)
            self._workers.append(to_ros)

    def _keyed_relay(
        self, node: Node, plan: RelayPlan, keys: KeyPath, settings: RelaySettings
    ) -> None:
        assert plan.from_ros is not None  # the only direction
        link = self._link(f"{plan.slot.name}/*", "<-", plan.topic, plan.of.name)
        relay = KeyedFromRos(self._board, plan.slot, keys, link, self._timer, settings)
        link.end = node.subscription(plan.name, plan.of, relay.arrived, plan.from_ros)

    def _client(self, node: Node, plan: ServicePlan) -> None:
        slots = plan.slots
        link = self._link(slots.request.name, "->", plan.full_name, slots.of.name)
        link.client = client = node.client(plan.name, slots.of)
        caller = SlotClient(self._board, slots, client, plan.timeout, link)
        self._workers.append(caller)

    def _server(self, node: Node, plan: ServicePlan) -> None:
        slots = plan.slots
        link = self._link(slots.request.name, "<-", plan.full_name, slots.of.name)
        answerer = SlotServer(self._board, slots, plan.timeout, link)
        self._workers.append(answerer)
        node.server(plan.name, slots.of, answerer.asked)

    def _action(self, node: Node, plan: ServicePlan, types: TypeLibrary, time: NodeTime) -> None:
        slots, arrow = plan.slots, "<-" if plan.serve else "->"
        link = self._link(slots.goal.name, arrow, plan.full_name, slots.of.name)
        place = ActionPlace(
            self._board, slots, node, plan.name, types, plan.timeout, link, self._timer
        )
        if plan.serve:
            self._workers.append(SlotActionServer(place, time.now_ns))
        else:
            self._workers.append(SlotActionClient(place))
            self._goals += [self._board[slots.goal], self._board[slots.cancel]]

    def _position(self, node: Node, plan: PositionPlan, service: str) -> None:
        in_ros = self._link(plan.pose.name, "->", service, plan.of.name)
        in_slots = self._link(plan.pose.name, "->", ANSWER.name, plan.of.name)
        position = PositionServer(self._board, plan.pose, plan.of, in_ros, in_slots)
        self._workers.append(position)
        try:
            node.server(SERVICE, plan.of, position.asked)
        except TransportUnavailableError as error:  # rclpy without the type's package
            in_ros.report_fault(f"{SERVICE} is not served in ROS: {error}", "unavailable")


def _arrivals(relays: Sequence[RelayPlan]) -> dict[str, LatestArrival[Any]]:
    """Make the place of the latest arrival for each slot that relays pass from topic to topic.

    All relays of a slot have one type. Those in both directions share nothing: of what comes from
    ROS, they send nothing back.
    """
    into = {relay.slot.name for relay in relays if relay.from_ros}
    out = {relay.slot.name for relay in relays if relay.to_ros and not relay.from_ros}
    return {name: LatestArrival() for name in into & out}


def _overridden(relay: RelayPlan, parameters: NodeParameters) -> RelayPlan:
    """Give a relay's ends the QoS that parameters of the node name."""
    topic, to_ros, from_ros = relay.topic, relay.to_ros, relay.from_ros
    if to_ros is not None:
        to_ros = overridden(to_ros, parameters, topic, "publisher", every=True)
    if from_ros is not None:
        from_ros = overridden(from_ros, parameters, topic, "subscription", every=True)
    return relay._replace(to_ros=to_ros, from_ros=from_ros)


def _is_commanded(slot: BoundSlot[Any]) -> bool:
    try:
        sample = slot.sample()
    except WhiteboardError:  # unreadable, or the board is closed
        return False
    return sample is not None and sample.writer != os.getpid() and writer_lives(sample)
