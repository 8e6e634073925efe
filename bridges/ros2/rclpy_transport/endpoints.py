"""Publishers, subscriptions, clients and servers through rclpy.

Messages of topics pass as bytes, those of our codec. For services rclpy takes and gives messages of
its own classes; through their bytes they become ours.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from functools import partial
from typing import Any, NamedTuple, TypeVar

from llfsm.bridges.ros2.calls import PendingCalls, PendingRequests
from llfsm.bridges.ros2.errors import TransportClosedError
from llfsm.bridges.ros2.graph import Endpoint
from llfsm.bridges.ros2.qos import Qos
from llfsm.bridges.ros2.rclpy_transport import api
from llfsm.bridges.ros2.rclpy_transport.context import RclpyContext
from llfsm.bridges.ros2.transport import (
    Client,
    Closable,
    MessageInfo,
    NoticeKind,
    Publisher,
    SerializedBytes,
    SerializedMessage,
    Server,
    ServiceRequest,
    TopicSubscription,
)
from llfsm.bridges.ros2.types import RosMessage, RosService
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

        decode = of.decode

        def take(data: bytes, info: dict[str, Any]) -> None:
            if not self._closed:
                arrived = MessageInfo(
                    info["source_timestamp"], info["publication_sequence_number"] or 0, b""
                )
                world.notifier.deliver(self.name, callback, SerializedBytes(data, arrived, decode))

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


# Requests that wait for a server, and responses for a client. DDS drops older ones beyond the
# depth, which is 10 by default; the caller would wait in vain.
_DEPTH = 1000


class RclpyClient(Client[Any, Any]):
    """Calls a service. Here rclpy has no time-out that does not block."""

    def __init__(
        self,
        owner: Closable,
        world: RclpyContext,
        node: api.NodeApi,
        name: str,
        of: RosService,
        qos: Qos,
    ) -> None:
        found = api.find_class(of.name)  # first: a failure leaves nothing to close
        super().__init__(owner)
        self.name = name
        self._world = world
        self._node = node
        self._encode = of.request.encode
        self._class = found
        self._calls = PendingCalls(name, of.response, world.notifier)
        self._client = node.create_client(self._class, name, qos_profile=_profile(world, qos))

    @property
    def ready(self) -> bool:
        """True if rclpy knows a server."""
        with suppress(self._world.rclpy.destroyed):  # it is being closed
            return not self._closed and self._client.service_is_ready()
        return False

    def call(self, request: Any, *, timeout: float) -> Future[Any]:
        """Send the request; a server that is not known now gets none."""
        rclpy, timer = self._world.rclpy, self._world.timer
        sent = rclpy.deserialize(self._encode(request), self._class.Request)
        with self._lifetime:
            self._check_open()
            call = self._calls.begin()
        if not self.ready:
            timer.call_soon(partial(self._calls.unserved, call, f"no server for {self.name}"))
            return call
        try:
            future = self._client.call_async(sent)
        except rclpy.destroyed:  # it was closed meanwhile, which has ended the call
            return call

        def on_response(done: api.Future) -> None:
            timer.call_soon(partial(self._calls.answered, call, rclpy.serialize(done.result())))

        def too_late() -> None:
            self._client.remove_pending_request(future)
            self._calls.timed_out(call)

        future.add_done_callback(on_response)
        timer.call_later(timeout, too_late)
        return call

    def _close(self) -> None:
        self._calls.close()
        self._node.destroy_client(self._client)

    def __str__(self) -> str:
        return f"the client of {self.name}"


class RclpyServer(Server):
    """Serves a service. A request that fails is not answered: ROS has no message for that."""

    def __init__(
        self,
        owner: Closable,
        world: RclpyContext,
        node: api.NodeApi,
        name: str,
        of: RosService,
        handler: Callable[[ServiceRequest[Any, Any]], None],
        qos: Qos,
    ) -> None:
        found = api.find_class(of.name)
        super().__init__(owner)
        self.name = name
        self._world = world
        self._node = node
        self._class = found
        self._requests = PendingRequests(name, of, handler, world.notifier)
        self._service = node.create_service(
            self._class, name, lambda request, _: request, qos_profile=_profile(world, qos)
        )
        # An answer may come later, which rclpy's callbacks cannot give without keeping its
        # executor busy. What its executor calls to send what the callback returned is the first
        # to know the request's header; here it takes the request in instead.
        self._send = self._service.send_response
        self._unsent: deque[tuple[Any, Any]] = deque()
        self._service.send_response = self._take

    def _take(self, request: Any, header: Any) -> None:
        info = MessageInfo(header.source_timestamp, header.request_id.sequence_number, b"")
        self._requests.take(self._world.rclpy.serialize(request), info, _Reply(self, header))

    def send(self, data: bytes, header: Any) -> None:
        """Send a response, on the executor's thread as rclpy itself does."""
        response = self._world.rclpy.deserialize(data, self._class.Response)
        self._unsent.append((response, header))
        self._world.run(self._send_next)

    def _send_next(self) -> None:
        with suppress(IndexError, self._world.rclpy.destroyed):  # the end has sent it
            response, header = self._unsent.popleft()
            self._send(response, header)

    def _close(self) -> None:
        self._requests.close()
        with suppress(self._world.rclpy.failure):
            while self._unsent:  # the executor would come too late
                self._send_next()
        self._node.destroy_service(self._service)


def _profile(world: RclpyContext, qos: Qos) -> object:
    return world.qos(qos._replace(depth=max(qos.depth, _DEPTH)))


class _Reply(NamedTuple):
    server: RclpyServer
    header: Any

    def answer(self, data: bytes) -> None:
        self.server.send(data, self.header)

    def fail(self, reason: str) -> None:
        """Do nothing: the caller waits for its own timeout."""
