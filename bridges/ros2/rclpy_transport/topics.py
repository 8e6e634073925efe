"""Publishers and subscriptions through rclpy, as bytes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from llfsm.whiteboard.message import M

from ..errors import TransportClosedError
from ..graph import Endpoint
from ..lifetime import Closable
from ..qos import Qos
from ..transport import (
    MessageInfo,
    Publisher,
    SerializedBytes,
    SerializedMessage,
    TopicSubscription,
)
from ..types import RosMessage
from . import api
from .context import RclpyContext

__all__ = ["RclpyPublisher", "RclpySubscription"]


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
        self._publisher = node.create_publisher(
            found, end.name, world.qos(qos), event_callbacks=world.rclpy.quiet[0]
        )
        world.ours[end] = None

    def publish(self, message: M) -> None:
        """Encode and publish a message."""
        data = self._encode(message)
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

        self._subscription = node.create_subscription(
            found,
            end.name,
            take,
            world.qos(qos),
            event_callbacks=world.rclpy.quiet[1],
            raw=True,
        )
        world.ours[end] = None

    def _close(self) -> None:
        self._world.ours.pop(self._end, None)
        self._node.destroy_subscription(self._subscription)
