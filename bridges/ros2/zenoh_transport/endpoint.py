"""What publishers, subscriptions, clients and servers over Zenoh have in common.

The attachment of each message: 33 bytes.

Sequence number and time in ns as 64 bits little-endian, the number 16, and 16 bytes that identify
the sender. A reply carries the sequence number and the sender of its request.

Receives from Zenoh on threads of ours.

Zenoh's own way of calling Python starts a thread that the interpreter waits for at its end: a
process that forgets to close a transport would never end.

The graph, from tokens that come and go.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable
from functools import partial
from struct import Struct
from typing import Any, NamedTuple, TypeVar

import xxhash
import zenoh
import zenoh.handlers

from llfsm.bridges.ros2.graph import Endpoint, Graph, Role
from llfsm.bridges.ros2.notices import Notifier
from llfsm.bridges.ros2.threads import TimerThread, join_at_exit
from llfsm.bridges.ros2.transport import MessageInfo
from llfsm.bridges.ros2.zenoh_transport.tokens import (
    Token,
    data_key,
    domain_tokens,
    endpoint_token,
    parse,
)

GID_SIZE = 16

_LAYOUT = Struct(f"<qqB{GID_SIZE}s")


def pack(sequence: int, time_ns: int, gid: bytes) -> bytes:
    """Return an attachment."""
    return _LAYOUT.pack(sequence, time_ns, GID_SIZE, gid)


def unpack(data: bytes) -> MessageInfo | None:
    """Return the metadata in an attachment, or None if the bytes are not one."""
    if len(data) != _LAYOUT.size:
        return None
    sequence, time_ns, size, gid = _LAYOUT.unpack(data)
    return MessageInfo(time_ns, sequence, gid) if size == GID_SIZE else None


T = TypeVar("T")


def hand_over(do: Callable[[T], None], timer: TimerThread) -> zenoh.handlers.Callback[T]:
    """Return a handler that calls ``do`` on another thread, so that Zenoh does not wait for it."""

    def callback(thing: T) -> None:
        timer.call_soon(partial(do, thing))

    return zenoh.handlers.Callback(callback, indirect=False)


def receive(take: Callable[[], T], do: Callable[[T], None], name: str) -> None:
    """Call ``do`` with what ``take`` returns, on a new thread, until its channel is closed."""

    def run() -> None:
        while True:
            try:
                thing = take()
            except zenoh.ZError:
                return  # its subscriber, its queryable or the session is closed
            do(thing)

    thread = threading.Thread(target=run, name=f"ros2 {name}", daemon=True)
    thread.start()
    join_at_exit(thread)


class Discovery:
    """Knows the tokens of a domain, and reports endpoints that are incompatible with ours."""

    def __init__(
        self, session: zenoh.Session, domain: int, notifier: Notifier, events: TimerThread
    ) -> None:
        self._ours = str(session.zid())
        self._notifier = notifier
        self._tokens: dict[str, Token] = {}
        self._by_name: dict[str, dict[str, Token]] = {}
        self._graph: Graph | None = None
        self._changed = threading.Condition()
        self._over = False
        self._subscriber: zenoh.Subscriber[Any] = session.liveliness().declare_subscriber(
            domain_tokens(domain), hand_over(self._on_token, events), history=True
        )

    def close(self) -> None:
        """Stop listening; waits return."""
        self._subscriber.undeclare()
        with self._changed:
            self._over = True
            self._changed.notify_all()

    def graph(self) -> Graph:
        """Return the graph as it is known now."""
        with self._changed:
            if self._graph is None:
                tokens = self._tokens.values()
                self._graph = Graph.of(
                    (token.node for token in tokens if token.endpoint is None), _endpoints(tokens)
                )
            return self._graph

    def wait(self, ready: Callable[[Graph], bool], timeout: float) -> bool | None:
        """Wait until ``ready(graph)`` is true; return None if it is closed meanwhile."""
        with self._changed:
            done = self._changed.wait_for(lambda: self._over or ready(self.graph()), timeout)
            return None if self._over else done

    def look_again(self, _: zenoh.MatchingStatus) -> None:
        """Wake all waits: something changed that no token shows."""
        with self._changed:
            self._changed.notify_all()

    def why_unserved(self, service: str) -> str:
        """Return why a call found no server with its type."""
        types = {end.type_name for end in self.named(service) if end.role is Role.SERVER}
        if types:
            return f"{service} is served, but with another type: {', '.join(sorted(types))}"
        return f"no server for {service}"

    def named(self, name: str) -> list[Endpoint]:
        """Return the endpoints of one name."""
        with self._changed:
            return list(_endpoints(self._by_name.get(name, {}).values()))

    def _on_token(self, sample: zenoh.Sample) -> None:
        key = str(sample.key_expr)
        token = parse(key)
        if token is None:
            return  # of a newer version of ROS, or of another program
        if sample.kind == zenoh.SampleKind.DELETE:
            self._remove(key, token)
        else:
            self._add(key, token)

    def _remove(self, key: str, token: Token) -> None:
        with self._changed:
            self._tokens.pop(key, None)
            if token.endpoint is not None:
                of_name = self._by_name.get(token.endpoint.name, {})
                of_name.pop(key, None)
                if not of_name:
                    self._by_name.pop(token.endpoint.name, None)
            self._announce()

    def _add(self, key: str, token: Token) -> None:
        with self._changed:
            self._tokens[key] = token
            others = []
            if token.endpoint is not None:
                of_name = self._by_name.setdefault(token.endpoint.name, {})
                others = list(of_name.values())
                of_name[key] = token
            self._announce()
        for other in others:
            for ours, theirs in ((other, token), (token, other)):
                if ours.session == self._ours and ours.endpoint and theirs.endpoint:
                    self._notifier.compare(ours.endpoint, theirs.endpoint)

    def _announce(self) -> None:
        self._graph = None
        self._changed.notify_all()


def _endpoints(tokens: Iterable[Token]) -> list[Endpoint]:
    return [token.endpoint for token in tokens if token.endpoint is not None]


class Connection(NamedTuple):
    """What every endpoint of a transport uses."""

    session: zenoh.Session
    discovery: Discovery
    notifier: Notifier
    domain: int
    events: TimerThread
    """Changes of the graph and of the connection."""
    answers: TimerThread
    """Results of calls, on a thread of their own: callbacks of one may wait for another."""


class ZenohEndpoint:
    """An endpoint on the graph: its key, its token, its gid."""

    def __init__(
        self, connection: Connection, node_token: str, number: int, end: Endpoint, dds_type: str
    ) -> None:
        self.connection = connection
        self.name = end.name
        self.key = data_key(connection.domain, end.name, dds_type, end.type_hash or "")
        self._token_key = endpoint_token(node_token, number, end, dds_type)
        # Messages do not carry their endpoint's token, so rmw_zenoh_cpp derives the gid from it.
        self.gid = xxhash.xxh3_128_intdigest(self._token_key.encode()).to_bytes(GID_SIZE, "little")
        self._token: zenoh.LivelinessToken | None = None

    def show(self) -> None:
        """Put the endpoint on the graph; to be done last, when it already works."""
        self._token = self.connection.session.liveliness().declare_token(self._token_key)

    def hide(self) -> None:
        """Take it off the graph; to be done first."""
        if self._token is not None:
            self._token.undeclare()
