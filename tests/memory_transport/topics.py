"""Publishers and subscriptions in memory."""

from __future__ import annotations

import time
from collections import deque

from llfsm.bridges.ros2.graph import Endpoint
from llfsm.bridges.ros2.qos import DurabilityPolicy, HistoryPolicy, Qos
from llfsm.bridges.ros2.transport import (
    Arrived,
    Closable,
    MessageInfo,
    Publisher,
    SerializedBytes,
    TopicSubscription,
)
from llfsm.bridges.ros2.types import RosMessage
from llfsm.whiteboard.message import M

from .inbox import Inbox
from .world import Member, Site

__all__ = ["MemoryPublisher", "MemorySubscription"]


class MemoryPublisher(Publisher[M], Member):
    """Puts messages into the inboxes of compatible subscriptions."""

    def __init__(
        self, owner: Closable, site: Site, node: str, end: Endpoint, of: RosMessage[M], qos: Qos
    ) -> None:
        super().__init__(owner)
        self.name = end.name
        self.gid = site.world.new_gid()
        self.qos = qos
        self._encode = of.encode
        self._sequence = 0
        kept = qos.depth if qos.history is HistoryPolicy.KEEP_LAST else None
        self.past: deque[tuple[bytes, MessageInfo]] = deque(
            maxlen=0 if qos.durability is DurabilityPolicy.VOLATILE else kept
        )
        self.join(site, node, end)

    def _send(self, data: bytes) -> None:
        with self.site.world.changed:  # a subscription that comes now gets it once
            self._check_open()
            self._sequence += 1
            info = MessageInfo(time.time_ns(), self._sequence, self.gid)
            self.past.append((data, info))
            for other in self.partners(MemorySubscription):
                other.take(self.qos, data, info)

    def _close(self) -> None:
        self.site.world.leave(self)

    def __str__(self) -> str:
        return f"the publisher of {self.name}"


class MemorySubscription(TopicSubscription, Member):
    """Has an inbox of the newest messages."""

    def __init__(
        self,
        owner: Closable,
        site: Site,
        node: str,
        end: Endpoint,
        of: RosMessage[M],
        qos: Qos,
        callback: Arrived[M],
    ) -> None:
        super().__init__(owner)
        self.name = end.name
        self._qos = qos

        def receive(arrived: tuple[bytes, MessageInfo]) -> None:
            site.notifier.deliver(self.name, callback, SerializedBytes(*arrived, of.decode))

        limit = qos.depth if qos.history is HistoryPolicy.KEEP_LAST else None
        self._inbox = Inbox(receive, limit, self.name)
        with site.world.changed:
            self.join(site, node, end)
            if qos.durability is DurabilityPolicy.TRANSIENT_LOCAL:
                for publisher in self.partners(MemoryPublisher):
                    for data, info in publisher.past:
                        self.take(publisher.qos, data, info)

    def take(self, offered: Qos, data: bytes, info: MessageInfo) -> None:
        """Queue a message, if what its publisher offers is enough."""
        if not self._qos.refused(offered):
            self._inbox.put((data, info))

    def _close(self) -> None:
        self.site.world.leave(self)
        self._inbox.close()
