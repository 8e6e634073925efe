"""Zenoh keys of ROS 2: where messages go, and the liveliness tokens that describe the graph.

    data      <domain>/<name>/<DDS type>/<type hash>
    node      @ros2_lv/<domain>/<session>/<node id>/<node id>/NN/<enclave>/<namespace>/<node>
    endpoint  @ros2_lv/<domain>/<session>/<node id>/<id>/<MP MS SS SC>/<enclave>/<namespace>/<node>
              /<name>/<DDS type>/<type hash>/<qos>

In a token a ``/`` inside a part is written ``%``, and so is an empty part. The qos is
``<reliability>:<durability>:<history>,<depth>:<deadline>:<lifespan>:<liveliness>``; what is left
out is the default.

A token exists as long as the session that declared it, so the graph needs no heartbeat of ours: it
is the set of tokens at the moment. Each new one is compared with ours of the same name.
"""

from __future__ import annotations

import threading
from collections import defaultdict
from collections.abc import Callable, Iterable
from enum import IntEnum
from functools import partial
from typing import Any, NamedTuple, TypeVar

import zenoh
import zenoh.handlers

from llfsm.bridges.ros2.graph import Endpoint, Graph, Role
from llfsm.bridges.ros2.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    LivelinessPolicy,
    Qos,
    ReliabilityPolicy,
)
from llfsm.bridges.ros2.threads import TimerThread, join_at_exit
from llfsm.bridges.ros2.transport import Notifier

T = TypeVar("T")

E = TypeVar("E", bound=IntEnum)

_ROOT = "@ros2_lv"
_CODES = {"MP": Role.PUBLISHER, "MS": Role.SUBSCRIPTION, "SS": Role.SERVER, "SC": Role.CLIENT}
_ROLES = {role: code for code, role in _CODES.items()}
_NODE_CODE = "NN"
_NODE_PARTS = 9
_ENDPOINT_PARTS = 13
_DEFAULT_DEPTH = 42  # of rmw_zenoh's default profile, which peers leave out of tokens
_DEFAULT = Qos(depth=_DEFAULT_DEPTH)
_SECOND = 1_000_000_000
_INFINITE_NS = 2**63 - 1  # ROS 2's infinite duration
_BEST_AVAILABLE_NS = _INFINITE_NS - 1
_BEST_AVAILABLE: dict[type[IntEnum], int] = {
    ReliabilityPolicy: 4,
    DurabilityPolicy: 4,
    LivelinessPolicy: 5,
}
_UNKNOWN: dict[type[IntEnum], int] = {
    ReliabilityPolicy: 3,
    DurabilityPolicy: 3,
    HistoryPolicy: 3,
    LivelinessPolicy: 4,
}
_LEAST = Qos(ReliabilityPolicy.BEST_EFFORT)
_MOST = Qos(
    durability=DurabilityPolicy.TRANSIENT_LOCAL, liveliness=LivelinessPolicy.MANUAL_BY_TOPIC
)


class Token(NamedTuple):
    """A parsed token."""

    session: str
    node: str
    """The node's full name."""
    endpoint: Endpoint | None
    """None: the token is the node's own."""


def data_key(domain: int, name: str, dds_type: str, type_hash: str) -> str:
    """Make the key under which a topic's messages are put, or a service is asked."""
    return f"{domain}/{name.strip('/')}/{dds_type}/{type_hash}"


def node_token(
    domain: int, session: str, number: int, namespace: str, node: str, enclave: str = ""
) -> str:
    """Make a node's token; ``number`` is its own within the session."""
    named = f"{_mangle(enclave)}/{_mangle(namespace)}/{node}"
    return f"{_ROOT}/{domain}/{session}/{number}/{number}/{_NODE_CODE}/{named}"


def endpoint_token(node: str, number: int, end: Endpoint, dds_type: str) -> str:
    """Make the token of an endpoint of the node whose token is ``node``."""
    root, domain, session, node_number, _, _, *named = node.split("/")
    topic = f"{_mangle(end.name)}/{dds_type}/{end.type_hash or '%'}"
    of = f"{root}/{domain}/{session}/{node_number}/{number}/{_ROLES[end.role]}"
    return "/".join((of, *named, topic, _qos_text(end.qos or _DEFAULT)))


def parse(key: str) -> Token | None:
    """Parse a token; return None if the key is not one."""
    parts = key.split("/")
    if len(parts) < _NODE_PARTS or parts[0] != _ROOT:
        return None
    session, code = parts[2], parts[5]
    node = f"{_demangle(parts[7]).rstrip('/')}/{parts[8]}"
    if code == _NODE_CODE and len(parts) == _NODE_PARTS:
        return Token(session, node, None)
    role = _CODES.get(code)
    if role is None or len(parts) != _ENDPOINT_PARTS:
        return None
    name, dds_type, type_hash, qos_text = parts[9:]
    try:
        qos = _parse_qos(qos_text, _MOST if role is Role.PUBLISHER else _LEAST)
    except ValueError:
        return None
    end = Endpoint(role, node, _demangle(name), _ros_type(dds_type), type_hash, qos)
    return Token(session, node, end)


def _mangle(name: str) -> str:
    return name.replace("/", "%") or "%"


def _demangle(part: str) -> str:
    return part.replace("%", "/")


def _ros_type(dds_type: str) -> str:
    """Turn ``package::msg::dds_::Name_`` into ``package/msg/Name``; leave other names."""
    package, *kind, name = dds_type.split("::")
    if len(kind) == 2 and kind[1] == "dds_" and name.endswith("_"):
        return f"{package}/{kind[0]}/{name[:-1]}"
    return dds_type


def _qos_text(qos: Qos) -> str:
    reliability, durability, history, depth, liveliness = (
        "" if getattr(qos, name) == getattr(_DEFAULT, name) else str(int(getattr(qos, name)))
        for name in ("reliability", "durability", "history", "depth", "liveliness")
    )
    deadline, lifespan, lease = map(
        _duration_text, (qos.deadline_ns, qos.lifespan_ns, qos.lease_ns)
    )
    return (
        f"{reliability}:{durability}:{history},{depth}:{deadline}:{lifespan}:{liveliness},{lease}"
    )


def _duration_text(ns: int) -> str:
    return "{},{}".format(*divmod(ns, _SECOND)) if ns else ","


def _parse_qos(text: str, available: Qos) -> Qos:
    """Parse a profile.

    "Best available" fits all others, and is read as that of ``available``; "unknown" is read as
    the default.
    """
    reliability, durability, history, deadline, lifespan, life = text.split(":")
    kind, depth = history.split(",")
    liveliness, *lease = life.split(",")
    return Qos(
        _policy(reliability, _DEFAULT.reliability, available.reliability),
        _policy(durability, _DEFAULT.durability, available.durability),
        _policy(kind, _DEFAULT.history, _DEFAULT.history),
        _number(depth, _DEFAULT_DEPTH),
        _parse_duration(deadline.split(",")),
        _parse_duration(lifespan.split(",")),
        _policy(liveliness, _DEFAULT.liveliness, available.liveliness),
        _parse_duration(lease),
    )


def _policy(text: str, default: E, available: E) -> E:
    kind, number = type(default), _number(text, default)
    if number == _UNKNOWN[kind]:
        return default
    return available if number == _BEST_AVAILABLE.get(kind) else kind(number)


def _parse_duration(parts: list[str]) -> int:
    seconds, ns = parts
    whole = int(seconds or _INFINITE_NS // _SECOND) * _SECOND + int(ns or _INFINITE_NS % _SECOND)
    return 0 if whole >= _BEST_AVAILABLE_NS else whole


def _number(text: str, default: int) -> int:
    return int(text or "0") or default  # 0 is "system default"


def hand_over(do: Callable[[T], None], timer: TimerThread) -> zenoh.handlers.Callback[T]:
    """Make a handler that calls ``do`` on another thread, so that Zenoh does not wait for it."""

    def callback(thing: T) -> None:
        timer.call_soon(partial(do, thing))

    return zenoh.handlers.Callback(callback, indirect=False)


def receive(take: Callable[[], T], do: Callable[[T], None], name: str) -> None:
    """Call ``do`` with what ``take`` returns, on a new thread, until its channel is closed.

    Zenoh's own way of calling Python starts a thread that the interpreter waits for at its end: a
    process that forgets to close a transport would never end.
    """

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
        self._by_name: defaultdict[str, dict[str, Token]] = defaultdict(dict)
        self._own: defaultdict[str, dict[str, Token]] = defaultdict(dict)  # this session's of these
        self._graph: Graph | None = None
        self._changed = threading.Condition()
        self._over = False
        self._subscriber: zenoh.Subscriber[Any] = session.liveliness().declare_subscriber(
            f"{_ROOT}/{domain}/**", hand_over(self._on_token, events), history=True
        )

    def close(self) -> None:
        """Stop listening; waits return."""
        self._subscriber.undeclare()
        with self._changed:
            self._over = True
            self._changed.notify_all()

    def graph(self) -> Graph:
        """Return the graph as it is known now; it is kept until a token comes or goes."""
        with self._changed:
            if self._graph is None:
                tokens = self._tokens.values()
                self._graph = Graph.of(
                    (token.node for token in tokens if token.endpoint is None), _endpoints(tokens)
                )
            return self._graph

    def wait(self, ready: Callable[[Graph], bool], timeout: float) -> bool | None:
        """Wait ``timeout`` seconds for ``ready(graph)``; None: it was closed meanwhile."""
        with self._changed:
            done = self._changed.wait_for(lambda: self._over or ready(self.graph()), timeout)
            return None if self._over else done

    def look_again(self, _: zenoh.MatchingStatus) -> None:
        """Wake all waits: something changed that no token shows."""
        with self._changed:
            self._changed.notify_all()

    def why_unserved(self, service: str) -> str:
        """Explain that a call found no server with its type."""
        types = {end.type_name for end in self.named(service) if end.role is Role.SERVER}
        if types:
            return f"{service} is served, but with another type: {', '.join(sorted(types))}"
        return f"no server for {service}"

    def named(self, name: str) -> list[Endpoint]:
        """List the endpoints of one name."""
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
                for by_name in (self._by_name, self._own):
                    by_name[token.endpoint.name].pop(key, None)
                    if not by_name[token.endpoint.name]:
                        del by_name[token.endpoint.name]
            self._announce()

    def _add(self, key: str, token: Token) -> None:
        with self._changed:
            self._tokens[key] = token
            others = []
            if token.endpoint is not None:
                name, is_own = token.endpoint.name, token.session == self._ours
                others = list((self._by_name if is_own else self._own).get(name, {}).values())
                self._by_name[name][key] = token
                if is_own:
                    self._own[name][key] = token
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
