"""The transport on rclpy."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from llfsm.bridges.ros2.errors import TransportClosedError
from llfsm.bridges.ros2.graph import NO_REMAPPING, Graph, Names, Role
from llfsm.bridges.ros2.qos import SERVICE, TOPIC, Qos
from llfsm.bridges.ros2.rclpy_transport.context import RclpyContext
from llfsm.bridges.ros2.rclpy_transport.endpoints import (
    RclpyClient,
    RclpyPublisher,
    RclpyServer,
    RclpySubscription,
)
from llfsm.bridges.ros2.transport import (
    Node,
    Notice,
    Notifier,
    SerializedMessage,
    ServiceRequest,
    Transport,
    log_notice,
)
from llfsm.bridges.ros2.types import RosMessage, RosService
from llfsm.whiteboard.message import M


class RclpyTransport(Transport):
    """A transport through the rclpy of the sourced environment.

    All callbacks run on one thread, that of its executor.
    """

    def __init__(
        self,
        domain: int | None = None,
        *,
        enclave: str = "",
        notify: Callable[[Notice], None] = log_notice,
    ) -> None:
        """Open it; ``domain`` defaults to ``ROS_DOMAIN_ID``. Raise :class:`.DomainIdError`."""
        super().__init__(domain)
        self._world = RclpyContext(self.domain, enclave, Notifier(notify))

    @property
    def up(self) -> bool:
        """True until rclpy's context is shut down."""
        return self._world.context.ok()

    def node(
        self, name: str, namespace: str = "/", remap: Mapping[str, str] = NO_REMAPPING
    ) -> Node:
        """Put a node on the graph."""
        with self._lifetime:
            self._check_open()
            return _RclpyNode(self, self._world, Names(name, namespace, remap))

    def graph(self) -> Graph:
        """Read the graph from rclpy."""
        self._check_open()
        return self._world.graph()

    def wait_graph(self, ready: Callable[[Graph], bool], timeout: float) -> bool:
        """Block until ``ready(graph)`` is true; it is checked 50 times a second."""
        done = None if self._closed else self._world.wait(lambda: ready(self.graph()), timeout)
        if done is None:
            raise TransportClosedError(f"{self} is closed")
        return done

    def _close(self) -> None:
        self._world.close()

    def __str__(self) -> str:
        return "the transport on rclpy"


class _RclpyNode(Node):
    def __init__(self, owner: RclpyTransport, world: RclpyContext, names: Names) -> None:
        node = world.new_node(names)  # first: a failure leaves nothing to close
        super().__init__(owner, names)
        self._world = world
        self._node = node

    def publisher(self, topic: str, of: RosMessage[M], qos: Qos = TOPIC) -> RclpyPublisher[M]:
        with self._lifetime:
            end = self._end(Role.PUBLISHER, topic, of, qos)
            return RclpyPublisher(self, self._world, self._node, end, of, qos)

    def subscription(
        self,
        topic: str,
        of: RosMessage[M],
        callback: Callable[[SerializedMessage[M]], None],
        qos: Qos = TOPIC,
    ) -> RclpySubscription:
        with self._lifetime:
            end = self._end(Role.SUBSCRIPTION, topic, of, qos)
            return RclpySubscription(self, self._world, self._node, end, of, callback, qos)

    def client(self, service: str, of: RosService, qos: Qos = SERVICE) -> RclpyClient:
        with self._lifetime:
            self._check_open()
            return RclpyClient(
                self, self._world, self._node, self._names.full_service(service), of, qos
            )

    def server(
        self,
        service: str,
        of: RosService,
        handler: Callable[[ServiceRequest[Any, Any]], None],
        qos: Qos = SERVICE,
    ) -> RclpyServer:
        with self._lifetime:
            self._check_open()
            name = self._names.full_service(service)
            return RclpyServer(self, self._world, self._node, name, of, handler, qos)

    def _close(self) -> None:
        self._world.remove_node(self._node)
