"""A transport: all that a bridge needs of ROS 2, whatever carries it.

    Transport            one way into one ROS domain
    └── Node        a node on its graph
        ├── Publisher       publish(message)
        ├── TopicSubscription    callback(arrival)
        ├── Client          call(request) -> future
        └── Server          handler(request), which may be answered later

What holds on every transport:

* **Threads.** Every method may be called from any thread. Callbacks run on threads of the
  transport: those of one entity never overlap, those of different entities may. They should return
  soon and must not wait for another callback.
* **The newest wins.** While a subscription's callback is busy, the newest ``depth`` messages wait
  for it and older ones are dropped unseen, as "keep last" says. A message that is dropped was
  never decoded.
* **Faults are told, not raised into threads.** What goes wrong outside a call (a lost router, a
  message that cannot be decoded, a type that does not fit) is a :class:`Notice` to the function
  that the transport was opened with; a fault of the same kind on the same topic is told once.
* **Closing** an entity takes it off the graph before ``close`` returns; a node closes its
  entities, a transport its nodes.

Names may be relative (``cmd_vel``), private (``~/pose``) or full; see :mod:`.names`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from enum import Enum
from typing import TYPE_CHECKING, Any, Generic, NamedTuple, TypeVar

from llfsm.whiteboard.message import M, Message

from .graph import Graph
from .lifetime import Closable
from .qos import SERVICE, TOPIC, Qos
from .ros_names import NO_REMAPPING

if TYPE_CHECKING:
    from .types import RosMessage, RosService

__all__ = [
    "Client",
    "MessageInfo",
    "Node",
    "Notice",
    "NoticeKind",
    "Publisher",
    "SerializedBytes",
    "SerializedMessage",
    "Server",
    "ServiceRequest",
    "TopicSubscription",
    "Transport",
]


class NoticeKind(Enum):
    """What a notice is about; the text is how it is logged."""

    DOWN = "down"
    """The way into ROS is lost: no router, or rclpy was shut down."""
    UP = "up"
    """It is there again."""
    TYPE_MISMATCH = "type mismatch"
    """Somebody has another type, or another version of it, under a name of ours."""
    QOS_MISMATCH = "QoS mismatch"
    """What one end offers is less than the other asks for."""
    BAD_MESSAGE = "bad message"
    """What arrived cannot be decoded, or comes without its attachment."""
    CALLBACK_FAILED = "callback failed"
    """A callback raised something; that message or request is lost, the next is delivered."""


class Notice(NamedTuple):
    """Something that happened to a transport outside any call."""

    kind: NoticeKind
    name: str
    """The topic or service; empty if it is about the whole transport."""
    text: str


class MessageInfo(NamedTuple):
    """What comes with a message."""

    source_ns: int
    """When it was published, by the publisher's wall clock: nanoseconds since 1970; 0: unknown."""
    sequence: int
    """The publisher's count of its messages; 0: unknown, or a publisher that starts there."""
    gid: bytes
    """The publisher's 16 bytes; empty: unknown."""


class SerializedMessage(ABC, Generic[M]):
    """A message that came in and is not decoded yet. It may be kept and used on any thread."""

    __slots__ = ()

    @property
    @abstractmethod
    def data(self) -> bytes:
        """The message as CDR, its encapsulation header included."""

    @property
    @abstractmethod
    def info(self) -> MessageInfo:
        """Where and when it comes from."""

    @abstractmethod
    def decode(self) -> M:
        """Return the message; raise :class:`.CdrError` if it is none of its type.

        In a callback that error need not be caught: the transport tells it.
        """


class SerializedBytes(SerializedMessage[M]):
    """An arrival whose bytes are here already."""

    __slots__ = ("_data", "_info", "_of")

    def __init__(self, data: bytes, info: MessageInfo, of: RosMessage[M]) -> None:
        self._data = data
        self._info = info
        self._of = of

    @property
    def data(self) -> bytes:
        """What was published."""
        return self._data

    @property
    def info(self) -> MessageInfo:
        """By whom and when."""
        return self._info

    def decode(self) -> M:
        """Return the message."""
        return self._of.decode(self._data)


class Publisher(Closable, Generic[M]):
    """Sends messages to a topic."""

    name: str
    """The topic's full name."""
    gid: bytes
    """What its messages carry as :attr:`MessageInfo.gid`; empty where that is not known."""

    @abstractmethod
    def publish(self, message: M) -> None:
        """Encode and send a message.

        A reliable publisher may block while the network is congested. While the transport is down
        the message is lost (transient local: kept for late subscriptions). Raise
        :class:`.CdrError` if a field's value does not fit its ROS type,
        :class:`.TransportClosedError` after ``close``.
        """


class TopicSubscription(Closable):
    """Gets the messages of a topic until it is closed."""

    name: str
    """The topic's full name."""


Req = TypeVar("Req", bound=Message)
Res = TypeVar("Res", bound=Message)


class Client(Closable, Generic[Req, Res]):
    """Calls a service."""

    name: str
    """The service's full name."""

    @property
    @abstractmethod
    def ready(self) -> bool:
        """Whether a server with our type is known; one may also be there and not be known yet."""

    @abstractmethod
    def call(self, request: Req, *, timeout: float) -> Future[Res]:
        """Send a request without waiting for the response, which the future will have.

        If there is none, the future has one of

        * :class:`.NoServerError`: nobody serves it,
        * :class:`.CallTimeoutError`: no answer within ``timeout`` seconds,
        * :class:`.CallFailedError`: the server refused, or went away while it was asked,
        * :class:`.CdrError`: the response is none of its type,
        * :class:`.TransportClosedError`: the client was closed before an answer came.

        Its done-callbacks run on a thread of the transport. ``cancel`` forgets the call; the server
        is not notified. Raise :class:`.CdrError` if a field's value does not fit its ROS type.
        """


class ServiceRequest(ABC, Generic[Req, Res]):
    """A request that somebody waits to have answered, by any thread at any time.

    One that is dropped without an answer has failed, as far as the middleware can tell the caller.
    """

    message: Req
    info: MessageInfo
    """When it was sent, the client's count of its requests, and the client's gid."""

    @abstractmethod
    def answer(self, response: Res) -> None:
        """Send the response.

        Raise :class:`.CdrError` if a field's value does not fit its ROS type (it may be answered
        again then), :class:`.AlreadyAnsweredError` the second time. If the caller or the transport
        is gone, nothing happens.
        """

    @abstractmethod
    def fail(self, reason: str) -> None:
        """Tell the caller that there is no response, in a way it can tell from one.

        ROS 2 itself has no such message: a caller that uses rclcpp or rclpy waits until its own
        time-out. Raise :class:`.AlreadyAnsweredError` the second time.
        """


class Server(Closable):
    """Serves a service until it is closed."""

    name: str
    """The service's full name."""


class Node(Closable):
    """A node on the graph, and the maker of its endpoints.

    Each maker raises :class:`.RosNameError` for a name that is not one, and
    :class:`.TransportClosedError` after ``close``.
    """

    name: str
    """Its full name, namespace included."""

    @abstractmethod
    def publisher(self, topic: str, of: RosMessage[M], qos: Qos = TOPIC) -> Publisher[M]:
        """Publish on a topic."""

    @abstractmethod
    def subscription(
        self,
        topic: str,
        of: RosMessage[M],
        callback: Callable[[SerializedMessage[M]], None],
        qos: Qos = TOPIC,
    ) -> TopicSubscription:
        """Have ``callback`` called with what is published on a topic."""

    @abstractmethod
    def client(self, service: str, of: RosService, qos: Qos = SERVICE) -> Client[Any, Any]:
        """Call a service."""

    @abstractmethod
    def server(
        self,
        service: str,
        of: RosService,
        handler: Callable[[ServiceRequest[Any, Any]], None],
        qos: Qos = SERVICE,
    ) -> Server:
        """Have ``handler`` called with each request; it answers at once or keeps the request.

        What the handler raises fails the request and is told as a notice.
        """


class Transport(Closable):
    """One way into one ROS domain."""

    domain: int
    """The ROS domain id."""

    @property
    @abstractmethod
    def up(self) -> bool:
        """Whether the way into ROS is there; see :attr:`NoticeKind.DOWN`."""

    @abstractmethod
    def node(
        self, name: str, namespace: str = "/", remap: Mapping[str, str] = NO_REMAPPING
    ) -> Node:
        """Put a node on the graph; raise :class:`.RosNameError` if a name is not one.

        ``remap`` gives names of topics and services that its endpoints use another name.
        """

    @abstractmethod
    def graph(self) -> Graph:
        """Return what is known of the graph now, our own nodes included."""

    @abstractmethod
    def wait_graph(self, ready: Callable[[Graph], bool], timeout: float) -> bool:
        """Block until ``ready`` says yes to the graph; False if ``timeout`` seconds pass before.

        Raise :class:`.TransportClosedError` if the transport is closed meanwhile.
        """
