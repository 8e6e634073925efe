"""Publishers, subscriptions, clients and servers over Zenoh, and the attachment of each message.

A topic is a key: publishers put, subscriptions have a ring of the newest samples. A call is a query
to all servers, of which the first reply counts; servers are queryables.

The attachment is 33 bytes: sequence number and time in ns as 64 bits little-endian, the number 16,
and 16 bytes that identify the sender. A reply carries the sequence number and the sender of its
request.
"""

from __future__ import annotations

import itertools
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import suppress
from functools import partial
from struct import Struct
from typing import Any, NamedTuple

import xxhash
import zenoh
import zenoh.ext
import zenoh.handlers

from llfsm.bridges.ros2.calls import PendingCalls, PendingRequests
from llfsm.bridges.ros2.errors import TransportClosedError, TransportError
from llfsm.bridges.ros2.graph import Endpoint, Role
from llfsm.bridges.ros2.qos import DurabilityPolicy, HistoryPolicy, Qos, ReliabilityPolicy
from llfsm.bridges.ros2.threads import TimerThread
from llfsm.bridges.ros2.transport import (
    Arrived,
    Client,
    Closable,
    Handler,
    MessageInfo,
    Notifier,
    Publisher,
    SerializedMessage,
    Server,
    TopicSubscription,
)
from llfsm.bridges.ros2.types import RosMessage, RosService
from llfsm.bridges.ros2.zenoh_transport.graph import Discovery, data_key, receive
from llfsm.whiteboard.message import M

GID_SIZE = 16

_LAYOUT = Struct(f"<qqB{GID_SIZE}s")


def pack(sequence: int, time_ns: int, gid: bytes) -> bytes:
    """Make an attachment."""
    return _LAYOUT.pack(sequence, time_ns, GID_SIZE, gid)


def unpack(data: bytes) -> MessageInfo | None:
    """Read the metadata in an attachment; None if the bytes are not one."""
    if len(data) != _LAYOUT.size:
        return None
    sequence, time_ns, size, gid = _LAYOUT.unpack(data)
    return MessageInfo(time_ns, sequence, gid) if size == GID_SIZE else None


class Connection(NamedTuple):
    """A transport's session and threads, for its endpoints."""

    session: zenoh.Session
    discovery: Discovery
    notifier: Notifier
    domain: int
    events: TimerThread
    """Changes of the graph and of the connection."""
    answers: TimerThread
    """Results of calls, on a thread of their own: callbacks of one may wait for another."""
    numbers: Iterator[int]
    """Of nodes and their endpoints, each used once."""


class Place(NamedTuple):
    """The parts of an endpoint, whatever its kind."""

    owner: Closable
    connection: Connection
    token: str
    """Its liveliness token."""
    end: Endpoint


class ZenohEndpoint(Closable):
    """An endpoint as it is on the graph: its key, its token, its gid."""

    def __init__(self, place: Place, dds_type: str) -> None:
        super().__init__(place.owner)
        self.connection = place.connection
        self.name = place.end.name
        self.key = data_key(self.connection.domain, self.name, dds_type, place.end.type_hash or "")
        # Messages do not carry their endpoint's token, so rmw_zenoh_cpp derives the gid from it.
        self.gid = xxhash.xxh3_128_intdigest(place.token.encode()).to_bytes(GID_SIZE, "little")
        self._token_key = place.token
        self._token: zenoh.LivelinessToken | None = None

    def _show(self) -> None:
        """Put the endpoint on the graph; to be done last, when it already works."""
        self._token = self.connection.session.liveliness().declare_token(self._token_key)

    def _hide(self) -> None:
        """Take it off the graph; to be done first."""
        if self._token is not None:
            self._token.undeclare()


_ALL = 1000  # messages that "keep all" keeps; beyond, the sender blocks
_HEARTBEAT = 0.5  # seconds between reports of what late subscriptions can request, as rmw_zenoh's
_UNKNOWN = MessageInfo(0, 0, b"")


class _ZenohPublisher(ZenohEndpoint, Publisher[M]):
    """Puts messages under the topic's key."""

    def __init__(self, place: Place, of: RosMessage[M], qos: Qos) -> None:
        super().__init__(place, of.dds_name)
        self._encode = of.encode
        self._sequence = 0
        self._in_sequence = threading.Lock()
        self._publisher = _declare_publisher(self, qos)
        self._put = self._publisher.put
        self._show()

    def forward(self, arrival: SerializedMessage[M]) -> None:
        # Zenoh does not copy what it received itself.
        self._send(arrival.payload if isinstance(arrival, _Sample) else arrival.data)

    def _send(self, data: bytes | zenoh.ZBytes) -> None:
        with self._in_sequence:
            self._sequence += 1
            attachment = pack(self._sequence, time.time_ns(), self.gid)
            try:
                self._put(data, attachment=attachment)
            except zenoh.ZError as error:
                if self.closed:
                    raise TransportClosedError(f"the publisher of {self.name} is closed") from error
                raise TransportError(f"{self.name}: {error}") from error

    def _close(self) -> None:
        self._hide()
        with self._in_sequence:  # Zenoh refuses to undeclare what another thread is using
            self._publisher.undeclare()


class _ZenohSubscription(ZenohEndpoint, TopicSubscription):
    """Takes the newest messages from a ring that Zenoh fills, on a thread of its own.

    What the ring drops never reaches Python.
    """

    def __init__(self, place: Place, of: RosMessage[M], qos: Qos, callback: Arrived[M]) -> None:
        super().__init__(place, of.dds_name)
        self._subscriber = _declare_subscriber(self, qos)
        deliver, decode = self.connection.notifier.deliver, of.decode

        def take(sample: zenoh.Sample) -> None:
            if not self._closed:
                deliver(self.name, callback, _Sample(sample, decode, self))

        receive(self._subscriber.handler.recv, take, self.name)
        self._show()

    def _close(self) -> None:
        self._hide()
        self._subscriber.undeclare()


class _Sample(SerializedMessage[M]):
    """A Zenoh sample: nothing of it is copied before it is asked for."""

    __slots__ = ("_decode", "_endpoint", "_sample")

    def __init__(
        self, sample: zenoh.Sample, decode: Callable[[bytes], M], endpoint: ZenohEndpoint
    ) -> None:
        self._sample = sample
        self._decode = decode
        self._endpoint = endpoint

    @property
    def payload(self) -> zenoh.ZBytes:
        return self._sample.payload

    @property
    def data(self) -> bytes:
        return self._sample.payload.to_bytes()

    @property
    def info(self) -> MessageInfo:
        attachment = self._sample.attachment
        info = unpack(attachment.to_bytes()) if attachment is not None else None
        if info is None:
            self._endpoint.connection.notifier.bad_message(
                self._endpoint.name, "no attachment of ROS 2"
            )
            return _UNKNOWN
        return info

    def decode(self) -> M:
        return self._decode(self._sample.payload.to_bytes())


def _declare_publisher(endpoint: ZenohEndpoint, qos: Qos) -> Any:
    """Declare a publisher of one of Zenoh's two kinds; late subscriptions need the advanced one."""
    reliable = qos.reliability is ReliabilityPolicy.RELIABLE
    congestion = zenoh.CongestionControl.BLOCK if reliable else zenoh.CongestionControl.DROP
    reliability = zenoh.Reliability.RELIABLE if reliable else zenoh.Reliability.BEST_EFFORT
    if qos.durability is DurabilityPolicy.VOLATILE:
        return endpoint.connection.session.declare_publisher(
            endpoint.key, congestion_control=congestion, reliability=reliability
        )
    detection = zenoh.ext.MissDetectionConfig(heartbeat=None, sporadic_heartbeat=_HEARTBEAT)
    return zenoh.ext.declare_advanced_publisher(
        endpoint.connection.session,
        endpoint.key,
        congestion_control=congestion,
        reliability=reliability,
        cache=zenoh.ext.CacheConfig(_kept(qos)),
        sample_miss_detection=detection if reliable else None,
        publisher_detection=True,
    )


def _declare_subscriber(endpoint: ZenohEndpoint, qos: Qos) -> Any:
    """Declare a subscriber of one of Zenoh's two kinds, whose handler keeps the QoS depth."""
    channel: zenoh.handlers.FifoChannel[Any] | zenoh.handlers.RingChannel[Any]
    if qos.history is HistoryPolicy.KEEP_ALL:
        channel = zenoh.handlers.FifoChannel(_ALL)
    else:
        channel = zenoh.handlers.RingChannel(qos.depth)
    if qos.durability is DurabilityPolicy.VOLATILE:
        return endpoint.connection.session.declare_subscriber(endpoint.key, channel)
    reliable = qos.reliability is ReliabilityPolicy.RELIABLE
    recovery = zenoh.ext.RecoveryConfig(periodic_queries=None, heartbeat=True)
    return zenoh.ext.declare_advanced_subscriber(
        endpoint.connection.session,
        endpoint.key,
        channel,
        history=zenoh.ext.HistoryConfig(detect_late_publishers=True, max_samples=_kept(qos)),
        recovery=recovery if reliable else None,
    )


def _kept(qos: Qos) -> int:
    return _ALL if qos.history is HistoryPolicy.KEEP_ALL else qos.depth


class _ZenohClient(ZenohEndpoint, Client[Any, Any]):
    """Calls a service whose servers are queryables."""

    def __init__(self, place: Place, of: RosService, _: Qos) -> None:
        super().__init__(place, of.dds_name)
        self._encode = of.request.encode
        self._call_soon = self.connection.answers.call_soon
        self._sequence = itertools.count(1)
        self._calls = PendingCalls(self.name, of.response, self.connection.notifier)
        # It knows whether a queryable exists; a server's token may be known too early.
        self._querier = self.connection.session.declare_querier(
            self.key, target=zenoh.QueryTarget.ALL_COMPLETE
        )
        # No callback: it would run on the thread that ends an advanced publisher, for which Zenoh's
        # `undeclare` waits with the interpreter's lock.
        self._listener: Any = self._querier.declare_matching_listener(zenoh.handlers.RingChannel(1))
        receive(self._listener.handler.recv, self.connection.discovery.look_again, self.name)
        self._show()

    @property
    def ready(self) -> bool:
        if self._closed:
            return False
        status: Any = self._querier.matching_status  # its stub says bool
        return bool(status.matching)

    def call(self, request: Any, *, timeout: float) -> Future[Any]:
        data = self._encode(request)
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
            self.connection.session.get(
                self.key,
                zenoh.handlers.Callback(on_reply, on_end, indirect=False),  # else a thread each
                target=zenoh.QueryTarget.ALL_COMPLETE,
                consolidation=zenoh.ConsolidationMode.NONE,
                timeout=timeout,  # which Zenoh enforces
                payload=data,
                attachment=pack(next(self._sequence), time.time_ns(), self.gid),
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
            self._calls.unserved(call, self.connection.discovery.why_unserved(self.name))

    def _close(self) -> None:
        self._hide()
        self._calls.close()
        self._listener.undeclare()
        self._querier.undeclare()


_WAITING = 256  # requests that may wait for the handler; beyond, callers block


class _ZenohServer(ZenohEndpoint, Server):
    """Serves a service as a queryable, on a thread of its own."""

    def __init__(self, place: Place, of: RosService, _: Qos, handler: Handler) -> None:
        super().__init__(place, of.dds_name)
        self._requests = PendingRequests(self.name, of, handler, self.connection.notifier)
        channel: zenoh.handlers.FifoChannel[zenoh.Query] = zenoh.handlers.FifoChannel(_WAITING)
        self._queryable = self.connection.session.declare_queryable(
            self.key, channel, complete=True
        )
        receive(self._queryable.handler.recv, self._on_query, self.name)
        self._show()

    def _on_query(self, query: zenoh.Query) -> None:
        attachment, payload = query.attachment, query.payload
        info = unpack(attachment.to_bytes()) if attachment is not None else None
        data = payload.to_bytes() if payload is not None else b""
        self._requests.take(data, info, _Reply(query, self.key, info))

    def _close(self) -> None:
        self._hide()
        self._queryable.undeclare()
        self._requests.close()


class _Reply(NamedTuple):
    """Ends a query with a response. If the caller or the session is gone, nothing happens."""

    query: zenoh.Query
    key: str
    info: MessageInfo | None

    def answer(self, data: bytes) -> None:
        assert self.info is not None
        attachment = pack(self.info.sequence, time.time_ns(), self.info.gid)
        with self.query as query, suppress(zenoh.ZError):
            query.reply(self.key, data, attachment=attachment)

    def fail(self, reason: str) -> None:
        with self.query as query, suppress(zenoh.ZError):
            query.reply_err(reason)


ENDPOINTS: dict[Role, Callable[..., ZenohEndpoint]] = {
    Role.PUBLISHER: _ZenohPublisher,
    Role.SUBSCRIPTION: _ZenohSubscription,
    Role.CLIENT: _ZenohClient,
    Role.SERVER: _ZenohServer,
}
"""The class of each kind; made of a place, a type, a QoS and, if it has one, a callback."""
