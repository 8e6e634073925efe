"""The transport in memory."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from llfsm.bridges.ros2.errors import TransportClosedError, TransportUnavailableError
from llfsm.bridges.ros2.graph import NO_REMAPPING, Graph, Names, Role
from llfsm.bridges.ros2.qos import SERVICE, TOPIC, Qos
from llfsm.bridges.ros2.threads import TimerThread
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

from .services import MemoryClient, MemoryServer
from .topics import MemoryPublisher, MemorySubscription
from .world import Member, MemoryWorld, Site

__all__ = ["MemoryTransport"]


class MemoryTransport(Transport):
    """A way into a world that is in this process."""

    def __init__(
        self,
        world: MemoryWorld,
        domain: int = 0,
        *,
        notify: Callable[[Notice], None] = log_notice,
    ) -> None:
        """Open it; raise :class:`.DomainIdError`."""
        super().__init__(domain)
        self._site = Site(world, domain, Notifier(notify), TimerThread("ros2 answers"))
        world.open(self._site.notifier)

    @property
    def up(self) -> bool:
        """Whether the world is there."""
        return self._site.world.up

    def node(
        self, name: str, namespace: str = "/", remap: Mapping[str, str] = NO_REMAPPING
    ) -> Node:
        """Put a node on the graph."""
        with self._lifetime:
            self._check_open()
            return _MemoryNode(self, self._site, Names(name, namespace, remap))

    def graph(self) -> Graph:
        """Return the graph of the domain."""
        return self._site.world.graph(self.domain)

    def wait_graph(self, ready: Callable[[Graph], bool], timeout: float) -> bool:
        """Block until ``ready`` says yes to the graph."""
        done = self._site.world.wait(lambda: self._closed or ready(self.graph()), timeout)
        if self._closed:
            raise TransportClosedError(f"{self} is closed")
        return done

    def _close(self) -> None:
        self._site.world.shut(self._site.notifier)
        self._site.timer.close()

    def __str__(self) -> str:
        return "the transport in memory"


class _MemoryNode(Node, Member):
    def __init__(self, owner: MemoryTransport, site: Site, names: Names) -> None:
        super().__init__(owner, names)
        self.join(site, self.name)

    def publisher(self, topic: str, of: RosMessage[M], qos: Qos = TOPIC) -> MemoryPublisher[M]:
        with self._lifetime:
            end = self._end(Role.PUBLISHER, topic, of, qos)
            return MemoryPublisher(self, self.site, self.name, end, of, qos)

    def subscription(
        self,
        topic: str,
        of: RosMessage[M],
        callback: Callable[[SerializedMessage[M]], None],
        qos: Qos = TOPIC,
    ) -> MemorySubscription:
        with self._lifetime:
            end = self._end(Role.SUBSCRIPTION, topic, of, qos)
            return MemorySubscription(self, self.site, self.name, end, of, callback, qos)

    def client(self, service: str, of: RosService, qos: Qos = SERVICE) -> MemoryClient:
        with self._lifetime:
            end = self._end(Role.CLIENT, service, of, qos)
            return MemoryClient(self, self.site, self.name, end, of)

    def server(
        self,
        service: str,
        of: RosService,
        handler: Callable[[ServiceRequest[Any, Any]], None],
        qos: Qos = SERVICE,
    ) -> MemoryServer:
        if of.name in self.site.world.missing_types:
            raise TransportUnavailableError(f"{of.name} is not built")
        with self._lifetime:
            end = self._end(Role.SERVER, service, of, qos)
            return MemoryServer(self, self.site, self.name, end, of, handler)

    def _close(self) -> None:
        self.site.world.leave(self)
