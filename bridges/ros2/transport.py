"""The transport: the interface to ROS 2 that a bridge uses, whatever middleware carries it.

    Transport                     access to one ROS domain
    └── Node                      a node on its graph
        ├── Publisher             publish(message)
        ├── TopicSubscription     callback(arrival)
        ├── Client                call(request) -> future
        └── Server                handler(request), which may be answered later

What holds on every transport:

* **Threads.** Every method may be called from any thread. Callbacks run on threads of the
  transport: those of one entity never overlap, those of different entities may. They should return
  soon and must not wait for another callback.
* **The newest wins.** While a subscription's callback runs, the newest ``depth`` messages wait for
  it and older ones are dropped ("keep last"). A dropped message is never decoded.
* **Faults are reported, not raised into threads.** What goes wrong outside a call (a lost router,
  a message that cannot be decoded, an incompatible type) is passed as a :class:`Notice` to the
  function that the transport was opened with, once for each kind of fault on a topic.
* **Closing** an entity takes it off the graph before ``close`` returns; a node closes its
  entities, a transport its nodes. Each is closed once, after the objects it owns.

Names may be relative (``cmd_vel``), private (``~/pose``) or full; see :class:`.Names`.
"""

from __future__ import annotations

import logging
import os
import threading
from abc import ABC, abstractmethod
from collections import defaultdict
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from contextlib import ExitStack
from enum import Enum
from typing import TYPE_CHECKING, Any, Generic, NamedTuple, TypeVar, cast

from llfsm.bridges.ros2.defaults import DOMAINS
from llfsm.bridges.ros2.errors import CdrError, DomainIdError, TransportClosedError
from llfsm.bridges.ros2.graph import (
    NO_REMAPPING,
    Endpoint,
    Graph,
    Names,
    Role,
    qos_conflict,
    type_conflict,
)
from llfsm.bridges.ros2.qos import SERVICE, TOPIC, Qos
from llfsm.whiteboard.closing import ClosedOnExit
from llfsm.whiteboard.message import M, Message

if TYPE_CHECKING:
    from llfsm.bridges.ros2.types import RosMessage, RosService

Req = TypeVar("Req", bound=Message)
Res = TypeVar("Res", bound=Message)
T = TypeVar("T")
_LOG = logging.getLogger("llfsm.bridges.ros2")
_MOST_NOTICES = 100  # of one kind about one name


class Closable(ClosedOnExit):
    """An object that any thread may close at any time, more than once.

    The objects it owns are closed first, the newest first. It is a context manager. Code that
    creates an owned object holds ``_lifetime`` meanwhile, so that nothing is created in an object
    that is being closed.
    """

    def __init__(self, owner: Closable | None = None) -> None:
        """Belong to ``owner``; raise :class:`.TransportClosedError` if that is closed."""
        self._closed = False
        self._owned: dict[Closable, None] = {}
        self._owner = owner
        # One for a whole tree: an owner that is closing gets no new things.
        self._lifetime: threading.RLock = owner._lifetime if owner else threading.RLock()
        if owner:
            with self._lifetime:
                owner._check_open()
                owner._owned[self] = None

    @property
    def closed(self) -> bool:
        """True once closing has begun."""
        return self._closed

    def close(self) -> None:
        """Close it and what it owns. Callbacks that have begun may still be running."""
        with self._lifetime:
            if self._closed:
                return
            self._closed = True
            owned = list(self._owned)
            if self._owner:
                self._owner._owned.pop(self, None)
        with ExitStack() as last_first:  # all of it, whatever one of them raises
            last_first.callback(self._close)
            for each in owned:
                last_first.callback(each.close)

    @abstractmethod
    def _close(self) -> None:
        """Release the resources of this object alone."""

    def _check_open(self) -> None:
        if self._closed:
            raise TransportClosedError(f"{self} is closed")


class NoticeKind(Enum):
    """The kind of a notice; its value is the text in the log."""

    DOWN = "down"
    """The connection to ROS is lost: no router, or rclpy was shut down."""
    UP = "up"
    """The connection is back."""
    TYPE_MISMATCH = "type mismatch"
    """Another node uses one of our names with another type, or another version of the type."""
    QOS_MISMATCH = "QoS mismatch"
    """A publisher offers less than a subscription requests."""
    QOS_BROKEN = "QoS broken"
    """A publisher has missed a deadline, or has given no sign of life in time."""
    BAD_MESSAGE = "bad message"
    """A message cannot be decoded, or has no attachment."""
    CALLBACK_FAILED = "callback failed"
    """A callback raised an error; that message or request is lost, the next is delivered."""


class Notice(NamedTuple):
    """An event on a transport outside any call."""

    kind: NoticeKind
    name: str
    """The topic or service; empty if the notice concerns the whole transport."""
    text: str


class MessageInfo(NamedTuple):
    """Metadata of a message."""

    source_ns: int
    """Time of publication by the publisher's clock, in nanoseconds since 1970; 0: unknown."""
    sequence: int
    """The publisher's sequence number; 0: unknown, or the first one if it counts from 0."""
    gid: bytes
    """The publisher's global identifier, 16 bytes; empty: unknown."""


class SerializedMessage(ABC, Generic[M]):
    """A received message, not decoded yet. It may be kept and used on any thread."""

    __slots__ = ()

    @property
    @abstractmethod
    def data(self) -> bytes:
        """The message as CDR, its encapsulation header included."""

    @property
    @abstractmethod
    def info(self) -> MessageInfo:
        """Its publisher, sequence number and time."""

    @abstractmethod
    def decode(self) -> M:
        """Decode the message; raise :class:`.CdrError` if the bytes are none.

        A callback need not catch that error: the transport reports it.
        """


class SerializedBytes(SerializedMessage[M]):
    """A received message whose bytes were copied from the middleware."""

    __slots__ = ("_decode", "data", "info")
    data: bytes
    info: MessageInfo

    def __init__(self, data: bytes, info: MessageInfo, decode: Callable[[bytes], M]) -> None:
        self.data = data
        self.info = info
        self._decode = decode

    def decode(self) -> M:
        """Decode the message; raise :class:`.CdrError`."""
        return self._decode(self.data)


Arrived = Callable[[SerializedMessage[M]], None]
"""A subscription's callback."""


class Publisher(Closable, Generic[M]):
    """Publishes messages on a topic."""

    name: str
    """The topic's full name."""
    gid: bytes
    """The :attr:`MessageInfo.gid` of its messages; empty where that is not known."""
    broken: int = 0
    """The times that the middleware has reported :attr:`NoticeKind.QOS_BROKEN`. Over Zenoh, as with
    rmw_zenoh_cpp, it does not."""

    _encode: Callable[[M], bytes]

    def publish(self, message: M) -> None:
        """Encode and send a message.

        A reliable publisher may block while the network is congested. While the transport is down
        the message is lost (transient local: kept for late subscriptions). Raise
        :class:`.CdrError` if a field's value does not fit its ROS type,
        :class:`.TransportClosedError` after ``close``.
        """
        self._send(self._encode(message))

    def forward(self, arrival: SerializedMessage[M]) -> None:
        """Send a received message of the topic's type as it came; nothing is encoded.

        As :meth:`publish`, it has this publisher's number and time.
        """
        self._send(arrival.data)

    @abstractmethod
    def _send(self, data: bytes) -> None:
        """Send an encoded message, with a number and the time."""


class TopicSubscription(Closable):
    """Receives the messages of a topic until it is closed."""

    name: str
    """The topic's full name."""
    broken: int = 0
    """As :attr:`Publisher.broken`."""


class Client(Closable, Generic[Req, Res]):
    """Calls a service."""

    name: str
    """The service's full name."""

    @property
    @abstractmethod
    def ready(self) -> bool:
        """True if a server with our type is known; a new server may not be known yet."""

    @abstractmethod
    def call(self, request: Req, *, timeout: float) -> Future[Res]:
        """Send a request and return a future of the response.

        Without a response the future raises one of

        * :class:`.NoServerError`: no server is known,
        * :class:`.CallTimeoutError`: no answer within ``timeout`` seconds,
        * :class:`.CallFailedError`: the server refused, or went away during the call,
        * :class:`.CdrError`: the response does not decode,
        * :class:`.TransportClosedError`: the client was closed before an answer came.

        Its done-callbacks run on a thread of the transport. ``cancel`` forgets the call; the server
        is not notified. Raise :class:`.CdrError` if a field's value does not fit its ROS type.
        """

    def __str__(self) -> str:
        return f"the client of {self.name}"


class ServiceRequest(ABC, Generic[Req, Res]):
    """A received request, which any thread may answer at any time.

    A request that is dropped without an answer fails, if the middleware can report that.
    """

    message: Req
    info: MessageInfo
    """The time of the request, its sequence number, and the client's gid."""

    @abstractmethod
    def answer(self, response: Res) -> None:
        """Send the response.

        Raise :class:`.CdrError` if a field's value does not fit its ROS type (it may be answered
        again then), :class:`.AlreadyAnsweredError` the second time. If the caller or the transport
        is gone, nothing happens.
        """

    @abstractmethod
    def fail(self, reason: str) -> None:
        """Report to the caller that there is no response.

        ROS 2 itself has no such message: callers with rclcpp or rclpy wait for their own timeout.
        Raise :class:`.AlreadyAnsweredError` the second time.
        """


Handler = Callable[[ServiceRequest[Any, Any]], None]
"""A server's callback."""


class Server(Closable):
    """Serves a service until it is closed."""

    name: str
    """The service's full name."""


class Node(Closable):
    """A node on the graph, which creates endpoints.

    Each of its methods raises :class:`.RosNameError` for an invalid name, and
    :class:`.TransportClosedError` after ``close``.
    """

    def __init__(self, owner: Closable, names: Names) -> None:
        super().__init__(owner)
        self.name = names.full_node
        """The full name, with the namespace."""
        self._names = names

    def publisher(self, topic: str, of: RosMessage[M], qos: Qos = TOPIC) -> Publisher[M]:
        """Create a publisher of a topic."""
        return cast("Publisher[M]", self._create(Role.PUBLISHER, topic, of, qos))

    def subscription(
        self, topic: str, of: RosMessage[M], callback: Arrived[M], qos: Qos = TOPIC
    ) -> TopicSubscription:
        """Create a subscription: ``callback`` is called with each message of a topic."""
        return cast("TopicSubscription", self._create(Role.SUBSCRIPTION, topic, of, qos, callback))

    def client(self, service: str, of: RosService, qos: Qos = SERVICE) -> Client[Any, Any]:
        """Create a client of a service."""
        return cast("Client[Any, Any]", self._create(Role.CLIENT, service, of, qos))

    def server(self, service: str, of: RosService, handler: Handler, qos: Qos = SERVICE) -> Server:
        """Create a server: ``handler`` gets each request and answers it, then or later.

        An error that the handler raises fails the request and is reported as a notice.
        """
        return cast("Server", self._create(Role.SERVER, service, of, qos, handler))

    def _create(self, role: Role, name: str, of: Any, qos: Qos, *callback: Any) -> Closable:
        with self._lifetime:
            self._check_open()
            topics = role in (Role.PUBLISHER, Role.SUBSCRIPTION)
            full = self._names.full(name) if topics else self._names.full_service(name)
            end = Endpoint(role, self.name, full, of.name, of.type_hash, qos)
            return self._make(end, of, qos, *callback)

    @abstractmethod
    def _make(self, end: Endpoint, of: Any, qos: Qos, *callback: Any) -> Closable:
        """Make the endpoint, of the transport's own class for its role."""

    def __str__(self) -> str:
        return f"the node {self.name}"


class Transport(Closable):
    """Access to one ROS domain."""

    def __init__(self, domain: int | None) -> None:
        """Belong to a domain, by default ``ROS_DOMAIN_ID``; raise :class:`.DomainIdError`."""
        super().__init__()
        self.domain = default_domain() if domain is None else check_domain(domain)
        """The ROS domain id, from 0 to 232."""

    @property
    @abstractmethod
    def up(self) -> bool:
        """True while the connection to ROS exists; see :attr:`NoticeKind.DOWN`."""

    def node(
        self, name: str, namespace: str = "/", remap: Mapping[str, str] = NO_REMAPPING
    ) -> Node:
        """Create a node; raise :class:`.RosNameError` if a name is invalid.

        ``remap`` maps names of topics and services to the names that its endpoints use instead.
        """
        with self._lifetime:
            self._check_open()
            return self._node(Names(name, namespace, remap))

    @abstractmethod
    def _node(self, names: Names) -> Node:
        """Put a node on the graph."""

    @abstractmethod
    def graph(self) -> Graph:
        """Return the graph as it is known now, with our own nodes."""

    def wait_graph(self, ready: Callable[[Graph], bool], timeout: float) -> bool:
        """Block until ``ready(graph)`` is true; return False after ``timeout`` seconds.

        Raise :class:`.TransportClosedError` if the transport is closed while waiting.
        """
        done = self._wait(ready, timeout)
        if done is None:
            raise TransportClosedError(f"{self} is closed")
        return done

    @abstractmethod
    def _wait(self, ready: Callable[[Graph], bool], timeout: float) -> bool | None:
        """Wait ``timeout`` seconds for ``ready(graph)``; None: it was closed meanwhile."""


def log_notice(notice: Notice) -> None:
    """Log a notice as a warning; :attr:`.NoticeKind.UP` as information."""
    level = logging.INFO if notice.kind is NoticeKind.UP else logging.WARNING
    _LOG.log(level, "%s", ": ".join(part for part in (notice.name, notice.text) if part))


class Notifier:
    """Passes notices to the function that a transport was opened with.

    An error of that function does not break the transport: it is logged.
    """

    def __init__(self, notify: Callable[[Notice], None]) -> None:
        self._notify = notify
        self._reported: defaultdict[tuple[NoticeKind, str], set[str]] = defaultdict(set)
        self._lock = threading.Lock()

    def notify(self, kind: NoticeKind, text: str, name: str = "") -> None:
        """Report an event each time."""
        try:
            self._notify(Notice(kind, name, text))
        except Exception:
            _LOG.exception("a function that gets notices failed")

    def once(self, kind: NoticeKind, name: str, text: str, about: str = "") -> None:
        """Report an event the first time for this kind, name and ``about``, up to a number."""
        with self._lock:
            reported = self._reported[kind, name]
            if about in reported or len(reported) > _MOST_NOTICES:
                return
            reported.add(about)
            if len(reported) > _MOST_NOTICES:  # nodes may come and go for ever
                text = "there are others, which are not reported"
        self.notify(kind, text, name)

    def bad_message(self, name: str, error: object) -> None:
        """Report that a message cannot be decoded."""
        self.once(NoticeKind.BAD_MESSAGE, name, f"{error}; further ones are dropped silently")

    def callback_failed(self, name: str, error: Exception) -> None:
        """Report that a callback raised ``error``; its traceback is logged each time."""
        _LOG.error("%s: a callback failed", name, exc_info=error)
        self.once(NoticeKind.CALLBACK_FAILED, name, f"a callback failed: {error!r}")

    def deliver(self, name: str, callback: Callable[[T], None], thing: T) -> None:
        """Call a callback, and report an error that it raises."""
        try:
            callback(thing)
        except CdrError as error:
            self.bad_message(name, error)
        except Exception as error:
            self.callback_failed(name, error)

    def compare(self, ours: Endpoint, theirs: Endpoint) -> None:
        """Report once why two endpoints of one name are incompatible."""
        if theirs.role not in (ours.role, ours.role.partner):
            return  # a topic and a service may have the same name
        for kind, conflict in (
            (NoticeKind.TYPE_MISMATCH, type_conflict(ours, theirs)),
            (NoticeKind.QOS_MISMATCH, qos_conflict(ours, theirs)),
        ):
            if conflict:
                self.once(kind, ours.name, conflict, about=conflict)


def check_domain(domain: int) -> int:
    """Check a ROS domain id, and return it; raise :class:`.DomainIdError` if it is not 0 to 232."""
    if domain not in DOMAINS:
        raise DomainIdError(f"the ROS domain id {domain} is not in 0 to {DOMAINS[-1]}")
    return domain


def default_domain() -> int:
    """Read ``ROS_DOMAIN_ID``, 0 if it is not set; raise :class:`.DomainIdError`."""
    text = os.environ.get("ROS_DOMAIN_ID", "")
    try:
        return check_domain(int(text or "0"))
    except ValueError as error:
        raise DomainIdError(
            f"ROS_DOMAIN_ID={text!r} is not a number from 0 to {DOMAINS[-1]}"
        ) from error
