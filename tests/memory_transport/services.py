"""Clients and servers in memory."""

from __future__ import annotations

import itertools
import time
from concurrent.futures import Future
from functools import partial
from typing import Any, NamedTuple

from llfsm.bridges.ros2.calls import PendingCalls, PendingRequests
from llfsm.bridges.ros2.graph import Endpoint
from llfsm.bridges.ros2.qos import Qos
from llfsm.bridges.ros2.threads import TimerThread
from llfsm.bridges.ros2.transport import Client, Closable, Handler, MessageInfo, Server
from llfsm.bridges.ros2.types import RosService

from .inbox import Inbox
from .world import Member, Site

__all__ = ["MemoryClient", "MemoryServer"]


class MemoryClient(Client[Any, Any], Member):
    """Asks all servers of a service; the first answer counts."""

    def __init__(
        self, owner: Closable, site: Site, node: str, end: Endpoint, of: RosService, _: Qos
    ) -> None:
        super().__init__(owner)
        self.name = end.name
        self._of = of
        self._gid = site.world.new_gid()
        self._sequence = itertools.count(1)
        self._calls = PendingCalls(end.name, of.response, site.notifier)
        self.join(site, node, end)

    @property
    def ready(self) -> bool:
        """Whether the world has a server with our type."""
        return bool(self.partners(MemoryServer))

    def call(self, request: Any, *, timeout: float) -> Future[Any]:
        """Put the request into every server's inbox."""
        data = self._of.request.encode(request)
        info = MessageInfo(time.time_ns(), next(self._sequence), self._gid)
        with self._lifetime:
            self._check_open()
            call = self._calls.begin()
        timer = self.site.timer
        servers = self.partners(MemoryServer)
        for server in servers:
            server.inbox.put(_Sent(data, info, _Reply(self._calls, call, timer)))
        if servers:
            timer.call_later(timeout, partial(self._calls.timed_out, call))
        else:
            timer.call_soon(partial(self._calls.unserved, call, f"no server for {self.name}"))
        return call

    def _close(self) -> None:
        self.site.world.leave(self)
        self._calls.close()


class _Reply(NamedTuple):
    calls: PendingCalls
    call: Future[Any]
    timer: TimerThread

    def answer(self, data: bytes) -> None:
        self.timer.call_soon(partial(self.calls.answered, self.call, data))

    def fail(self, reason: str) -> None:
        self.timer.call_soon(partial(self.calls.failed, self.call, reason))


class _Sent(NamedTuple):
    data: bytes
    info: MessageInfo
    back: _Reply


class MemoryServer(Server, Member):
    """Has an inbox of requests."""

    def __init__(
        self,
        owner: Closable,
        site: Site,
        node: str,
        end: Endpoint,
        of: RosService,
        _: Qos,
        handler: Handler,
    ) -> None:
        super().__init__(owner)
        self.name = end.name
        self._requests = PendingRequests(end.name, of, handler, site.notifier)
        self.inbox: Inbox[_Sent] = Inbox(lambda sent: self._requests.take(*sent), None, end.name)
        self.join(site, node, end)

    def _close(self) -> None:
        self.site.world.leave(self)
        for sent in self.inbox.close():
            sent.back.fail("the server was closed")
        self._requests.close()
