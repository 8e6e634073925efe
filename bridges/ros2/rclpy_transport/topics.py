"""Publishers and subscriptions through rclpy, as bytes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

from llfsm.bridges.ros2.errors import TransportClosedError
from llfsm.bridges.ros2.graph import Endpoint
from llfsm.bridges.ros2.qos import Qos
from llfsm.bridges.ros2.rclpy_transport import api
from llfsm.bridges.ros2.rclpy_transport.context import RclpyContext
from llfsm.bridges.ros2.transport import (
    Closable,
    MessageInfo,
    NoticeKind,
    Publisher,
    SerializedBytes,
    SerializedMessage,
    TopicSubscription,
)
from llfsm.bridges.ros2.types import RosMessage
from llfsm.whiteboard.message import M

E = TypeVar("E")


class RclpyPublisher(Publisher[M]):
    """Gives rclpy what our codec wrote."""

    gid = b""  # rclpy does not report it

    def __init__(
        self,
        owner: Closable,
        world: RclpyContext,
        node: api.NodeApi,
        end: Endpoint,
        of: RosMessage[M],
        qos: Qos,
    ) -> None:
        found = api.find_class(of.name)  # first: a failure leaves nothing to close
        super().__init__(owner)
        self.name = end.name
        self._world = world
        self._node = node
        self._end = end
        self._encode = of.encode

        def create(events: Any) -> api.PublisherApi:
            return node.create_publisher(found, end.name, world.qos(qos), event_callbacks=events)

        self._publisher = _with_events(world, self, qos, world.rclpy.publisher_events, create)
        world.ours[end] = None

    def publish(self, message: M) -> None:
        """Encode and publish a message."""
        self._send(self._encode(message))

    def forward(self, arrival: SerializedMessage[M]) -> None:
        """Publish a message as it came."""
        self._send(arrival.data)

    def _send(self, data: bytes) -> None:
        try:
            self._publisher.publish(data)
        except self._world.rclpy.destroyed as error:
            raise TransportClosedError(f"the publisher of {self.name} is closed") from error

    def _close(self) -> None:
        self._world.ours.pop(self._end, None)
        self._node.destroy_publisher(self._publisher)


class RclpySubscription(TopicSubscription):
    """Takes messages from rclpy as they came; the middleware keeps the newest."""

    def __init__(
        self,
        owner: Closable,
        world: RclpyContext,
        node: api.NodeApi,
        end: Endpoint,
        of: RosMessage[M],
        callback: Callable[[SerializedMessage[M]], None],
        qos: Qos,
    ) -> None:
        found = api.find_class(of.name)
        super().__init__(owner)
        self.name = end.name
        self._world = world
        self._node = node
        self._end = end

        def take(data: bytes, info: dict[str, Any]) -> None:
            if not self._closed:
                arrived = MessageInfo(
                    info["source_timestamp"], info["publication_sequence_number"] or 0, b""
                )
                world.notifier.deliver(self.name, callback, SerializedBytes(data, arrived, of))

        def create(events: Any) -> object:
            return node.create_subscription(
                found, end.name, take, world.qos(qos), event_callbacks=events, raw=True
            )

        self._subscription = _with_events(world, self, qos, world.rclpy.subscription_events, create)
        world.ours[end] = None

    def _close(self) -> None:
        self._world.ours.pop(self._end, None)
        self._node.destroy_subscription(self._subscription)


def _with_events(
    world: RclpyContext,
    end: RclpyPublisher[Any] | RclpySubscription,
    qos: Qos,
    events: Callable[..., Any],
    create: Callable[[Any], E],
) -> E:
    """Create an end whose missed deadlines and signs of life are reported, if its QoS has any.

    Not every middleware reports them: rmw_zenoh_cpp does not.
    """

    def broken(what: str, times: int) -> None:
        if times > 0:
            end.broken += times
            text = f"{what}; further times are only counted"
            world.notifier.once(NoticeKind.QOS_BROKEN, end.name, text, about=what)

    callbacks: dict[str, Callable[[Any], None]] = {}
    if qos.deadline_ns:
        what = f"a deadline of {qos.deadline_ns / 1e9:g} s was missed"
        callbacks["deadline"] = lambda info: broken(what, info.total_count_change)
    if qos.lease_ns:
        silent = f"no sign of life of a publisher within {qos.lease_ns / 1e9:g} s"

        def alive(info: Any) -> None:  # the two kinds of ends get different structures
            lost = getattr(info, "not_alive_count_change", None)
            broken(silent, info.total_count_change if lost is None else lost)

        callbacks["liveliness"] = alive
    try:
        return create(events(use_default_callbacks=False, **callbacks))
    except world.rclpy.unsupported_event:
        return create(events(use_default_callbacks=False))
