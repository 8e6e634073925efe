"""The transport on rclpy."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from llfsm.bridges.ros2.graph import Endpoint, Graph, Names
from llfsm.bridges.ros2.qos import Qos
from llfsm.bridges.ros2.rclpy_transport.context import RclpyContext
from llfsm.bridges.ros2.rclpy_transport.endpoints import ENDPOINTS, Place, RclpyEndpoint
from llfsm.bridges.ros2.transport import Node, Notice, Notifier, Transport, log_notice


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
        up: bool = self._world.context.ok()
        return up

    def _node(self, names: Names) -> Node:
        return _RclpyNode(self, self._world, names)

    def graph(self) -> Graph:
        """Read the graph from rclpy."""
        self._check_open()
        return self._world.graph()

    def _wait(self, ready: Callable[[Graph], bool], timeout: float) -> bool | None:
        return None if self._closed else self._world.wait(lambda: ready(self.graph()), timeout)

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

    def _make(self, end: Endpoint, of: Any, qos: Qos, *callback: Any) -> RclpyEndpoint:
        return ENDPOINTS[end.role](Place(self, self._world, self._node, end), of, qos, *callback)

    def _close(self) -> None:
        self._world.remove_node(self._node)
