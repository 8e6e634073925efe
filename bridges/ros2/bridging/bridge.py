"""A running bridge: the links of a plan between a board and a transport."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from typing import Any, Protocol

from llfsm.whiteboard import Board, WhiteboardError
from llfsm.whiteboard.liveness import writer_lives
from llfsm.whiteboard.messages.turtle_sensor_poster import ANSWER

from ..errors import TransportUnavailableError
from ..notices import log_notice
from ..qos import DurabilityPolicy
from ..timer_thread import TimerThread
from ..transport import Node, Notice, Transport
from .bridge_plan import BridgePlan, PositionPlan, RelayPlan, ServicePlan
from .echo_filter import EchoFilter
from .link import BridgeLink, LinkFaults
from .relays import FromRos, ToRos
from .slot_client import SlotClient
from .slot_server import SlotServer
from .turtle_position import NODE, SERVICE, PositionServer

__all__ = ["Bridge"]

_LOOK_S = 0.05  # nothing reports that a process has ended


class _Worker(Protocol):
    def finish(self) -> None: ...
    def close(self) -> None: ...


class Bridge:
    """Connects a board with a ROS graph until it is closed.

    The board and the transport stay open.
    """

    def __init__(
        self,
        plan: BridgePlan,
        board: Board,
        transport: Transport,
        notify: Callable[[Notice], None] = log_notice,
        *,
        history: float = 1.0,
    ) -> None:
        """Start. ``notify`` gets the faults of links, each kind once for a link.

        ``history`` is how many seconds a latched topic has to deliver what it has kept before its
        slot is published. Raise :class:`.SlotTypeError` if a slot was made with another type since
        the plan was made.
        """
        self.links: list[BridgeLink] = []
        self._board = board
        self._history = history
        self._faults = LinkFaults(notify)
        self._timer = TimerThread("bridge rates")
        self._workers: list[_Worker] = []
        self._to_ros: list[ToRos[Any]] = []
        self._nodes: list[Node] = []
        try:
            self._connect(plan, transport)
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """End all links, after publishing what is on the slots by now."""
        for worker in self._workers:
            worker.finish()
        for worker in self._workers:
            worker.close()
        for node in self._nodes:
            node.close()
        self._timer.close()

    def linger(self, at_most: float = 1.5) -> None:
        """Give the programs that command robots through the bridge time to command a stop.

        It waits while a process lives that has added to a slot relayed to ROS, and ``at_most`` so
        many seconds: machines that are asked to stop have a grace period of one. That their board
        was removed asks them, too.
        """
        until = time.monotonic() + at_most
        while time.monotonic() < until and any(map(_is_commanded, self._to_ros)):
            time.sleep(_LOOK_S)  # nothing signals the end of another user's or parent's process

    def _connect(self, plan: BridgePlan, transport: Transport) -> None:
        node = transport.node(plan.node.node, plan.node.namespace)
        self._nodes.append(node)
        for relay in plan.relays:
            self._relay(node, relay)
        for client in plan.clients:
            self._client(node, client)
        for server in plan.servers:
            self._server(node, server)
        if plan.position:
            self._position(transport, plan.position)

    def _link(self, slot: str, arrow: str, name: str, type_name: str) -> BridgeLink:
        link = BridgeLink(slot, arrow, name, type_name)
        self.links.append(link)
        return link

    def _relay(self, node: Node, plan: RelayPlan) -> None:
        slot, echo, publisher = self._board[plan.slot], None, None
        if plan.to_ros:
            publisher = node.publisher(plan.topic, plan.of, plan.to_ros)
            if plan.from_ros:
                echo = EchoFilter(publisher, plan.of)
        if plan.from_ros:
            link = self._link(plan.slot.name, "<-", plan.topic, plan.of.name)
            relay = FromRos(slot, link, self._faults, self._timer, period=plan.period, echo=echo)
            node.subscription(plan.topic, plan.of, relay.arrived, plan.from_ros)
        if publisher is not None and plan.to_ros is not None:
            link = self._link(plan.slot.name, "->", plan.topic, plan.of.name)
            to_ros = ToRos(
                slot,
                publisher,
                link,
                self._faults,
                period=plan.period,
                latched=plan.to_ros.durability is DurabilityPolicy.TRANSIENT_LOCAL,
                history=self._history,
                echo=echo,
            )
            self._to_ros.append(to_ros)
            self._workers.append(to_ros)

    def _client(self, node: Node, plan: ServicePlan) -> None:
        slots = plan.slots
        link = self._link(slots.request.name, "->", plan.service, slots.of.name)
        client = node.client(plan.service, slots.of)
        caller = SlotClient(self._board, slots, client, plan.timeout, link, self._faults)
        self._workers.append(caller)

    def _server(self, node: Node, plan: ServicePlan) -> None:
        slots = plan.slots
        link = self._link(slots.request.name, "<-", plan.service, slots.of.name)
        answerer = SlotServer(self._board, slots, plan.timeout, link, self._faults)
        self._workers.append(answerer)
        node.server(plan.service, slots.of, answerer.asked)

    def _position(self, transport: Transport, plan: PositionPlan) -> None:
        node = transport.node(NODE)
        self._nodes.append(node)
        in_ros = self._link(plan.pose.name, "->", f"/{SERVICE}", plan.of.name)
        in_slots = self._link(plan.pose.name, "->", ANSWER.name, plan.of.name)
        position = PositionServer(self._board, plan.pose, plan.of, in_ros, in_slots, self._faults)
        self._workers.append(position)
        try:
            node.server(SERVICE, plan.of, position.asked)
        except TransportUnavailableError as error:  # rclpy without the type's package
            self._faults.report(in_ros, f"{SERVICE} is not served in ROS: {error}", "unavailable")


def _is_commanded(relay: ToRos[Any]) -> bool:
    try:
        sample = relay.slot.sample()
    except WhiteboardError:  # unreadable, or the board is closed
        return False
    return sample is not None and sample.writer != os.getpid() and writer_lives(sample)
