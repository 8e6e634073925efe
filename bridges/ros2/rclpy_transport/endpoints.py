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
from typing import Any, NamedTuple

from llfsm.bridges.ros2.calls import PendingCalls, PendingRequests
from llfsm.bridges.ros2.errors import TransportClosedError
from llfsm.bridges.ros2.graph import Endpoint, Role
from llfsm.bridges.ros2.qos import Qos
from llfsm.bridges.ros2.rclpy_transport import api
from llfsm.bridges.ros2.rclpy_transport.context import RclpyContext
from llfsm.bridges.ros2.transport import (
    Arrived,
    Client,
    Closable,
    Handler,
    MessageInfo,
    NoticeKind,
    Publisher,
    SerializedBytes,
    Server,
    TopicSubscription,
)
from llfsm.bridges.ros2.types import RosMessage, RosService
from llfsm.whiteboard.message import M


class Place(NamedTuple):
    """The parts of an endpoint, whatever its kind."""

    owner: Closable
    world: RclpyContext
    node: Any
    """Of rclpy."""
    end: Endpoint


class RclpyEndpoint(Closable):
    """An endpoint of an rclpy node."""

    def __init__(self, place: Place, of: RosMessage[Any] | RosService) -> None:
        self._class = api.find_class(of.name)  # first: a failure leaves nothing to close
        super().__init__(place.owner)
        self.name = place.end.name
        self._world, self._node, self._end = place[1:]


class _RclpyPublisher(RclpyEndpoint, Publisher[M]):
    """Gives rclpy what our codec wrote."""

    gid = b""  # rclpy does not report it

    def __init__(self, place: Place, of: RosMessage[M], qos: Qos) -> None:
        super().__init__(place, of)
        self._encode = of.encode
        world, create = self._world, self._node.create_publisher
        self._publisher = _with_events(
            self, qos, world.rclpy.publisher_events, partial(create, self._class, self.name)
        )
        world.ours[self._end] = None

    def _send(self, data: bytes) -> None:
        try:
            self._publisher.publish(data)
        except self._world.rclpy.destroyed as error:
            raise TransportClosedError(f"the publisher of {self.name} is closed") from error

    def _close(self) -> None:
        self._world.ours.pop(self._end, None)
        self._node.destroy_publisher(self._publisher)


class _RclpySubscription(RclpyEndpoint, TopicSubscription):
    """Takes messages from rclpy as they came; the middleware keeps the newest."""

    def __init__(self, place: Place, of: RosMessage[M], qos: Qos, callback: Arrived[M]) -> None:
        super().__init__(place, of)
        world, decode = self._world, of.decode

        def take(data: bytes, info: dict[str, Any]) -> None:
            if not self._closed:
                arrived = MessageInfo(
                    info["source_timestamp"], info["publication_sequence_number"] or 0, b""
                )
                world.notifier.deliver(self.name, callback, SerializedBytes(data, arrived, decode))

        create = partial(
            self._node.create_subscription, self._class, self.name, callback=take, raw=True
        )
        self._subscription = _with_events(self, qos, world.rclpy.subscription_events, create)
        world.ours[self._end] = None

    def _close(self) -> None:
        self._world.ours.pop(self._end, None)
        self._node.destroy_subscription(self._subscription)


def _with_events(
    end: _RclpyPublisher[Any] | _RclpySubscription,
    qos: Qos,
    events: Callable[..., Any],
    create: Callable[..., Any],
) -> Any:
    """Create an end whose missed deadlines and signs of life are reported, if its QoS has any.

    Not every middleware reports them: rmw_zenoh_cpp does not.
    """
    world, profile = end._world, end._world.qos(qos)

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
        wanted = events(use_default_callbacks=False, **callbacks)
        return create(qos_profile=profile, event_callbacks=wanted)
    except world.rclpy.unsupported_event:
        none = events(use_default_callbacks=False)
        return create(qos_profile=profile, event_callbacks=none)


# Requests that wait for a server, and responses for a client. DDS drops older ones beyond the
# depth, which is 10 by default; the caller would wait in vain.
_DEPTH = 1000


class _RclpyClient(RclpyEndpoint, Client[Any, Any]):
    """Calls a service. Here rclpy has no time-out that does not block."""

    def __init__(self, place: Place, of: RosService, qos: Qos) -> None:
        super().__init__(place, of)
        self._encode = of.request.encode
        self._calls = PendingCalls(self.name, of.response, self._world.notifier)
        self._client = self._node.create_client(
            self._class, self.name, qos_profile=_profile(self._world, qos)
        )

    @property
    def ready(self) -> bool:
        with suppress(self._world.rclpy.destroyed):  # it is being closed
            return not self._closed and self._client.service_is_ready()
        return False

    def call(self, request: Any, *, timeout: float) -> Future[Any]:
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

        def on_response(done: Any) -> None:
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


class _RclpyServer(RclpyEndpoint, Server):
    """Serves a service. A request that fails is not answered: ROS has no message for that."""

    def __init__(self, place: Place, of: RosService, qos: Qos, handler: Handler) -> None:
        super().__init__(place, of)
        self._requests = PendingRequests(self.name, of, handler, self._world.notifier)
        profile = _profile(self._world, qos)
        self._service = self._node.create_service(
            self._class, self.name, lambda request, _: request, qos_profile=profile
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
    server: _RclpyServer
    header: Any

    def answer(self, data: bytes) -> None:
        self.server.send(data, self.header)

    def fail(self, reason: str) -> None:
        """Do nothing: the caller waits for its own timeout."""


ENDPOINTS: dict[Role, Callable[..., RclpyEndpoint]] = {
    Role.PUBLISHER: _RclpyPublisher,
    Role.SUBSCRIPTION: _RclpySubscription,
    Role.CLIENT: _RclpyClient,
    Role.SERVER: _RclpyServer,
}
"""The class of each kind; made of a place, a type, a QoS and, if it has one, a callback."""
