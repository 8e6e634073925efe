"""The world that transports in memory share: its nodes and endpoints."""

from __future__ import annotations

import itertools
import threading
from collections.abc import Callable
from typing import NamedTuple, TypeVar

from llfsm.bridges.ros2.graph import Endpoint, Graph
from llfsm.bridges.ros2.threads import TimerThread
from llfsm.bridges.ros2.transport import NoticeKind, Notifier

__all__ = ["Member", "MemoryWorld", "Site"]


class Member:
    """A node or an endpoint in a world: what has a place on its graph."""

    def join(self, site: Site, node: str, end: Endpoint | None = None) -> None:
        """Take the place; to be done last."""
        self.site = site
        self.node = node
        self.end = end
        site.world.enter(self)

    def partners(self, of: type[Mem]) -> list[Mem]:
        """Return the members of a kind with this one's name and type, if the world is up."""
        world = self.site.world
        with world.changed:
            return [
                other
                for other in world.named(self)
                if world.up
                and isinstance(other, of)
                and other.end
                and self.end
                and other.end.type_hash == self.end.type_hash
            ]


Mem = TypeVar("Mem", bound=Member)


class MemoryWorld:
    """The graphs of all domains. Transports that are opened with the same world meet in it.

    It can be lost and come back, as a router does; meanwhile nothing is delivered.
    """

    def __init__(self) -> None:
        self._members: dict[Member, None] = {}
        self._notifiers: dict[Notifier, None] = {}
        self._gids = itertools.count(1)
        self.changed = threading.Condition()
        """Held while members change, or while something is delivered to all of them."""
        self.up = True
        self.missing_types: set[str] = set()
        """Types of services whose packages are not built: no server can be made of them."""

    def lose(self) -> None:
        """Go down; every transport reports it."""
        self._turn(False, NoticeKind.DOWN, "the world is lost")

    def restore(self) -> None:
        """Come back; every transport reports it."""
        self._turn(True, NoticeKind.UP, "the world is back")

    def _turn(self, up: bool, kind: NoticeKind, text: str) -> None:
        with self.changed:
            changed, self.up = self.up is not up, up
            notifiers = list(self._notifiers)
        if changed:
            for notifier in notifiers:
                notifier.notify(kind, text)

    def new_gid(self) -> bytes:
        """Return 16 unique bytes."""
        return next(self._gids).to_bytes(16, "little")

    def open(self, notifier: Notifier) -> None:
        """Notify this transport from now on."""
        with self.changed:
            self._notifiers[notifier] = None

    def shut(self, notifier: Notifier) -> None:
        """Notify this transport no more; waits for the graph check whether it is closed."""
        with self.changed:
            self._notifiers.pop(notifier, None)
            self.changed.notify_all()

    def enter(self, member: Member) -> None:
        """Add a member, and report incompatible endpoints."""
        with self.changed:
            others = self.named(member)
            self._members[member] = None
            self.changed.notify_all()
        for other in others:
            if member.end and other.end:
                member.site.notifier.compare(member.end, other.end)
                other.site.notifier.compare(other.end, member.end)

    def leave(self, member: Member) -> None:
        """Remove a member."""
        with self.changed:
            self._members.pop(member, None)
            self.changed.notify_all()

    def graph(self, domain: int) -> Graph:
        """Return a domain's graph."""
        with self.changed:
            members = [member for member in self._members if member.site.domain == domain]
        return Graph.of(
            (member.node for member in members if not member.end),
            (member.end for member in members if member.end),
        )

    def wait(self, ready: Callable[[], bool], timeout: float) -> bool:
        """Wait until a condition on the members becomes true."""
        with self.changed:
            return self.changed.wait_for(ready, timeout)

    def named(self, member: Member) -> list[Member]:
        """Return the endpoints that have the name of this one."""
        return [
            other
            for other in self._members
            if other.site.domain == member.site.domain
            and other.end
            and member.end
            and other.end.name == member.end.name
        ]


class Site(NamedTuple):
    """Where the members of one transport are."""

    world: MemoryWorld
    domain: int
    notifier: Notifier
    timer: TimerThread
