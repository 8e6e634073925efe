"""Publishers and subscriptions over Zenoh."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

import zenoh
import zenoh.ext
import zenoh.handlers

from llfsm.bridges.ros2.errors import TransportClosedError, TransportError
from llfsm.bridges.ros2.qos import DurabilityPolicy, HistoryPolicy, Qos, ReliabilityPolicy
from llfsm.bridges.ros2.transport import (
    Closable,
    MessageInfo,
    Publisher,
    SerializedMessage,
    TopicSubscription,
)
from llfsm.bridges.ros2.types import RosMessage
from llfsm.bridges.ros2.zenoh_transport.endpoint import ZenohEndpoint, pack, receive, unpack
from llfsm.whiteboard.message import M

_ALL = 1000  # messages that "keep all" keeps; beyond, the sender blocks
_HEARTBEAT = 0.5  # seconds between reports of what late subscriptions can request, as rmw_zenoh's
_UNKNOWN = MessageInfo(0, 0, b"")


class ZenohPublisher(Publisher[M]):
    """Puts messages under the topic's key."""

    def __init__(
        self, owner: Closable, endpoint: ZenohEndpoint, of: RosMessage[M], qos: Qos
    ) -> None:
        super().__init__(owner)
        self.name = endpoint.name
        self.gid = endpoint.gid
        self._endpoint = endpoint
        self._encode = of.encode
        self._sequence = 0
        self._in_sequence = threading.Lock()
        self._publisher = _declare_publisher(endpoint, qos)
        self._put = self._publisher.put
        endpoint.show()

    def publish(self, message: M) -> None:
        """Encode and put a message, with its number and the time."""
        self._send(self._encode(message))

    def forward(self, arrival: SerializedMessage[M]) -> None:
        """Put a message as it came; Zenoh does not copy what it received itself."""
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
        self._endpoint.hide()
        with self._in_sequence:  # Zenoh refuses to undeclare what another thread is using
            self._publisher.undeclare()


class ZenohSubscription(TopicSubscription):
    """Takes the newest messages from a ring that Zenoh fills, on a thread of its own.

    What the ring drops never reaches Python.
    """

    def __init__(
        self,
        owner: Closable,
        endpoint: ZenohEndpoint,
        of: RosMessage[M],
        callback: Callable[[SerializedMessage[M]], None],
        qos: Qos,
    ) -> None:
        super().__init__(owner)
        self.name = endpoint.name
        self._endpoint = endpoint
        self._subscriber = _declare_subscriber(endpoint, qos)
        deliver = endpoint.connection.notifier.deliver

        def take(sample: zenoh.Sample) -> None:
            if not self._closed:
                deliver(self.name, callback, _Sample(sample, of, endpoint))

        receive(self._subscriber.handler.recv, take, endpoint.name)
        endpoint.show()

    def _close(self) -> None:
        self._endpoint.hide()
        self._subscriber.undeclare()


class _Sample(SerializedMessage[M]):
    """A Zenoh sample: nothing of it is copied before it is asked for."""

    __slots__ = ("_endpoint", "_of", "_sample")

    def __init__(self, sample: zenoh.Sample, of: RosMessage[M], endpoint: ZenohEndpoint) -> None:
        self._sample = sample
        self._of = of
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
        return self._of.decode(self._sample.payload.to_bytes())


def _declare_publisher(endpoint: ZenohEndpoint, qos: Qos) -> Any:
    """Return a publisher, of one of Zenoh's two kinds."""
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
    """Return a subscriber, of one of Zenoh's two kinds, whose handler keeps the QoS depth."""
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
