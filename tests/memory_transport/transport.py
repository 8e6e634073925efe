"""The transport in memory."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from llfsm.bridges.ros2.errors import TransportUnavailableError
from llfsm.bridges.ros2.graph import Endpoint, Graph, Names, Role
from llfsm.bridges.ros2.qos import Qos
from llfsm.bridges.ros2.threads import TimerThread
from llfsm.bridges.ros2.transport import (
    Closable,
    Node,
    Notice,
    Notifier,
    Transport,
    log_notice,
)

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

    def _node(self, names: Names) -> Node:
        return _MemoryNode(self, self._site, names)

    def graph(self) -> Graph:
        """Return the graph of the domain."""
        return self._site.world.graph(self.domain)

    def _wait(self, ready: Callable[[Graph], bool], timeout: float) -> bool | None:
        done = self._site.world.wait(lambda: self._closed or ready(self.graph()), timeout)
        return None if self._closed else done

    def _close(self) -> None:
        self._site.world.shut(self._site.notifier)
        self._site.timer.close()

    def __str__(self) -> str:
        return "the transport in memory"


class _MemoryNode(Node, Member):
    def __init__(self, owner: MemoryTransport, site: Site, names: Names) -> None:
        super().__init__(owner, names)
        self.join(site, self.name)

    def _make(self, end: Endpoint, of: Any, qos: Qos, *callback: Any) -> Closable:
        if end.role is Role.SERVER and of.name in self.site.world.missing_types:
            raise TransportUnavailableError(f"{of.name} is not built")
        return _KINDS[end.role](self, self.site, self.name, end, of, qos, *callback)

    def _close(self) -> None:
        self.site.world.leave(self)


_KINDS: dict[Role, Callable[..., Closable]] = {
    Role.PUBLISHER: MemoryPublisher,
    Role.SUBSCRIPTION: MemorySubscription,
    Role.CLIENT: MemoryClient,
    Role.SERVER: MemoryServer,
}
