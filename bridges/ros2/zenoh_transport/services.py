"""Clients and servers over Zenoh.

A call is a query to all servers, of which the first reply counts. Servers are queryables that
answer with the number and the sender of the request.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from functools import partial
from typing import Any

import zenoh
import zenoh.handlers

from llfsm.bridges.ros2.calls import PendingCalls, PendingRequests
from llfsm.bridges.ros2.transport import Client, Closable, MessageInfo, Server, ServiceRequest
from llfsm.bridges.ros2.types import RosService
from llfsm.bridges.ros2.zenoh_transport.endpoint import ZenohEndpoint, pack, receive, unpack


class ZenohClient(Client[Any, Any]):
    """Calls a service whose servers are queryables."""

    def __init__(self, owner: Closable, endpoint: ZenohEndpoint, of: RosService) -> None:
        super().__init__(owner)
        self.name = endpoint.name
        self._endpoint = endpoint
        self._of = of
        self._call_soon = endpoint.connection.answers.call_soon
        self._sequence = itertools.count(1)
        self._calls = PendingCalls(endpoint.name, of.response, endpoint.connection.notifier)
        # It knows whether a queryable exists; a server's token may be known too early.
        self._querier = endpoint.connection.session.declare_querier(
            endpoint.key, target=zenoh.QueryTarget.ALL_COMPLETE
        )
        discovery = endpoint.connection.discovery
        # No callback: it would run on the thread that ends an advanced publisher, for which Zenoh's
        # `undeclare` waits with the interpreter's lock.
        self._listener: Any = self._querier.declare_matching_listener(zenoh.handlers.RingChannel(1))
        receive(self._listener.handler.recv, discovery.look_again, endpoint.name)
        endpoint.show()

    @property
    def ready(self) -> bool:
        """Whether a server with our type can be asked."""
        if self._closed:
            return False
        status: Any = self._querier.matching_status  # its stub says bool
        return bool(status.matching)

    def call(self, request: Any, *, timeout: float) -> Future[Any]:
        """Send a query; Zenoh enforces the timeout."""
        data = self._of.request.encode(request)
        with self._lifetime:
            self._check_open()
            call = self._calls.begin()
        deadline = time.monotonic() + timeout
        served = self.ready

        def on_reply(reply: zenoh.Reply) -> None:
            self._call_soon(partial(self._on_reply, call, deadline, reply))

        def on_end() -> None:
            self._call_soon(partial(self._on_end, call, served))

        try:
            self._endpoint.connection.session.get(
                self._endpoint.key,
                zenoh.handlers.Callback(on_reply, on_end, indirect=False),  # else a thread each
                target=zenoh.QueryTarget.ALL_COMPLETE,
                consolidation=zenoh.ConsolidationMode.NONE,
                timeout=timeout,
                payload=data,
                attachment=pack(next(self._sequence), time.time_ns(), self._endpoint.gid),
            )
        except zenoh.ZError as error:
            self._calls.failed(call, str(error))
        return call

    def _on_reply(self, call: Future[Any], deadline: float, reply: zenoh.Reply) -> None:
        if reply.ok is not None:
            self._calls.answered(call, reply.ok.payload.to_bytes())
        elif reply.err is not None:
            reason = reply.err.payload.to_bytes().decode(errors="replace")
            if reason == "Timeout" and time.monotonic() >= deadline:  # Zenoh's own reply
                self._calls.timed_out(call)
            else:
                self._calls.failed(call, reason)

    def _on_end(self, call: Future[Any], served: bool) -> None:
        """Conclude that no reply will come any more."""
        if call.done():
            return
        if served or self.ready:
            self._calls.failed(call, "the server gave no answer")
        else:
            self._calls.unserved(call, self._endpoint.connection.discovery.why_unserved(self.name))

    def _close(self) -> None:
        self._endpoint.hide()
        self._calls.close()
        self._listener.undeclare()
        self._querier.undeclare()

    def __str__(self) -> str:
        return f"the client of {self.name}"


_WAITING = 256  # requests that may wait for the handler; beyond, callers block


class ZenohServer(Server):
    """Serves a service as a queryable, on a thread of its own."""

    def __init__(
        self,
        owner: Closable,
        endpoint: ZenohEndpoint,
        of: RosService,
        handler: Callable[[ServiceRequest[Any, Any]], None],
    ) -> None:
        super().__init__(owner)
        self.name = endpoint.name
        self._endpoint = endpoint
        self._requests = PendingRequests(endpoint.name, of, handler, endpoint.connection.notifier)
        channel: zenoh.handlers.FifoChannel[zenoh.Query] = zenoh.handlers.FifoChannel(_WAITING)
        self._queryable = endpoint.connection.session.declare_queryable(
            endpoint.key, channel, complete=True
        )
        receive(self._queryable.handler.recv, self._on_query, endpoint.name)
        endpoint.show()

    def _on_query(self, query: zenoh.Query) -> None:
        attachment, payload = query.attachment, query.payload
        info = unpack(attachment.to_bytes()) if attachment is not None else None
        data = payload.to_bytes() if payload is not None else b""
        self._requests.take(data, info, _Reply(query, self._endpoint.key, info))

    def _close(self) -> None:
        self._endpoint.hide()
        self._queryable.undeclare()
        self._requests.close()


class _Reply:
    """Ends a query with a response. If the caller or the session is gone, nothing happens."""

    def __init__(self, query: zenoh.Query, key: str, info: MessageInfo | None) -> None:
        self._query = query
        self._key = key
        self._info = info

    def answer(self, data: bytes) -> None:
        assert self._info is not None
        attachment = pack(self._info.sequence, time.time_ns(), self._info.gid)
        with self._query as query, suppress(zenoh.ZError):
            query.reply(self._key, data, attachment=attachment)

    def fail(self, reason: str) -> None:
        with self._query as query, suppress(zenoh.ZError):
            query.reply_err(reason)
