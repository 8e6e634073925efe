"""The transport on Zenoh: its session, configured as those of rmw_zenoh, and its nodes.

A session is a peer that connects to a router and discovers other peers through it, without
multicast. The environment configures it as it does rmw_zenoh: ``ZENOH_SESSION_CONFIG_URI`` names a
base file, ``ZENOH_CONFIG_OVERRIDE`` is ``path=value;path=value``, values in JSON5.
"""

from __future__ import annotations

import atexit
import itertools
import json
import os
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import zenoh

from llfsm.bridges.ros2.defaults import ROUTER
from llfsm.bridges.ros2.errors import TransportUnavailableError
from llfsm.bridges.ros2.graph import Endpoint, Graph, Names
from llfsm.bridges.ros2.qos import Qos
from llfsm.bridges.ros2.threads import TimerThread
from llfsm.bridges.ros2.transport import Node, Notice, NoticeKind, Notifier, Transport, log_notice
from llfsm.bridges.ros2.zenoh_transport.endpoints import ENDPOINTS, Connection, Place, ZenohEndpoint
from llfsm.bridges.ros2.zenoh_transport.graph import (
    Discovery,
    endpoint_token,
    hand_over,
    node_token,
)
from llfsm.whiteboard.mirror.settings import endpoint_problem
from llfsm.whiteboard.mirror.zenoh_internals import error_text

_OVERRIDE = "ZENOH_CONFIG_OVERRIDE"
_PEER: dict[str, Any] = {
    "mode": "peer",
    "connect/endpoints": [ROUTER],
    "connect/timeout_ms": -1,  # keep trying until a router is there
    "connect/exit_on_failure": False,
    "connect/retry": {"period_init_ms": 100, "period_max_ms": 1000, "period_increase_factor": 2},
    "listen/endpoints": ["tcp/localhost:0"],
    "scouting/multicast/enabled": False,
    "scouting/gossip/enabled": True,
}
_ALWAYS: dict[str, Any] = {
    "scouting/delay": 1,  # ms that opening takes; it waits for no other peer
    "timestamping/enabled": True,  # histories are ordered by time stamps
    "transport/shared_memory/enabled": False,  # not used, and its file outlives a killed process
    # Batches of 64 KB that may wait to be sent, the most that Zenoh accepts. With its own 2, who
    # publishes a large message sleeps again and again until the thread that sends has made room.
    "transport/link/tx/queue/size/data": 16,
    # As rmw_zenoh. Who stalls for longer than the others' leases takes their connections for dead.
    # Zenoh makes them again, but its subscriptions are lost. On a busy host, 10 s are too short.
    "transport/link/tx/lease": 60_000,
    "transport/link/tx/keep_alive": 2,
}


def open_node_session(router: Sequence[str] | None) -> tuple[zenoh.Session, list[str]]:
    """Open a node's session; return it with the endpoints where it looks for a router.

    ``router`` overrides the environment. Raise :class:`.TransportUnavailableError` if either
    cannot be used.
    """
    for problem in filter(None, map(endpoint_problem, router or ())):
        raise TransportUnavailableError(f"router: {problem}")
    path = os.environ.get("ZENOH_SESSION_CONFIG_URI")
    if path:
        with _explaining(f"ZENOH_SESSION_CONFIG_URI={path}: "):
            config = zenoh.Config.from_file(path)
    else:
        config = _configured(_ALWAYS | _PEER)
    for entry in filter(None, map(str.strip, os.environ.get(_OVERRIDE, "").split(";"))):
        name, _, value = entry.partition("=")
        _insert(config, name.strip(), value.strip(), f"{_OVERRIDE}: {entry}: ")
    if router is not None:
        _insert(config, "connect/endpoints", json.dumps(list(router)), "router: ")
    return _open(config), json.loads(config.get_json("connect/endpoints"))


def open_with(settings: dict[str, Any]) -> zenoh.Session:
    """Open a session with settings alone; raise :class:`.TransportUnavailableError`."""
    return _open(_configured(_ALWAYS | settings))


def _configured(settings: Mapping[str, Any]) -> zenoh.Config:
    config = zenoh.Config()
    for name, value in settings.items():
        _insert(config, name, json.dumps(value))
    return config


def _insert(config: zenoh.Config, name: str, value: str, source: str = "") -> None:
    with _explaining(source):
        config.insert_json5(name, value)


def _open(config: zenoh.Config) -> zenoh.Session:
    with _explaining():
        return zenoh.open(config)


@contextmanager
def _explaining(source: str = "") -> Iterator[None]:
    try:
        yield
    except zenoh.ZError as error:
        raise TransportUnavailableError(f"{source}{error_text(error)}") from error


_GRACE = 1.0  # seconds that opening waits for a router before it reports its absence


class ZenohTransport(Transport):
    """A transport on the graph of nodes that use rmw_zenoh_cpp.

    It reports a lost router and reconnects by itself: within a second of the router's return its
    nodes are on the graph again. Meanwhile nodes that are connected already still communicate.
    """

    def __init__(
        self,
        domain: int | None = None,
        *,
        router: Sequence[str] | None = None,
        enclave: str = "",
        notify: Callable[[Notice], None] = log_notice,
    ) -> None:
        """Open a session, with or without a router; without one it takes a second.

        ``domain`` defaults to ``ROS_DOMAIN_ID``, ``router`` (endpoints as ``tcp/localhost:7447``)
        to the environment's. Raise :class:`.DomainIdError` and
        :class:`.TransportUnavailableError`.
        """
        super().__init__(domain)
        self._enclave = enclave
        self._notifier = Notifier(notify)
        self._session, self._router = open_node_session(router)
        self._session_id = str(self._session.zid())
        self._numbers = itertools.count()
        events, answers = TimerThread("ros2 events"), TimerThread("ros2 answers")
        self._discovery = Discovery(self._session, self.domain, self._notifier, events)
        self._connection = Connection(
            self._session, self._discovery, self._notifier, self.domain, events, answers
        )
        self._routers: set[str] = set()
        self._reported_up = True
        self._met = threading.Condition()
        self._listener = self._session.info.declare_transport_events_listener(
            hand_over(self._on_transport, events), history=True
        )
        atexit.register(self.close)  # so that it leaves no ghost nodes if it is never closed
        with self._met:
            self._met.wait_for(lambda: self.up, _GRACE)
        self._report_router()

    @property
    def up(self) -> bool:
        """True if it is connected to a router, or configured for none."""
        return not self._router or bool(self._routers)

    def _node(self, names: Names) -> Node:
        number, space = next(self._numbers), names.namespace
        token = node_token(self.domain, self._session_id, number, space, names.node, self._enclave)
        return _ZenohNode(self, names, token, self._connection, self._numbers)

    def graph(self) -> Graph:
        """Return the graph that the tokens describe now."""
        return self._discovery.graph()

    def _wait(self, ready: Callable[[Graph], bool], timeout: float) -> bool | None:
        return self._discovery.wait(ready, timeout)

    def __str__(self) -> str:
        return "the transport on Zenoh"

    def _close(self) -> None:
        atexit.unregister(self.close)
        self._listener.undeclare()
        self._discovery.close()
        self._session.close()
        self._connection.events.close()
        self._connection.answers.close()

    def _on_transport(self, event: zenoh.TransportEvent) -> None:
        if event.transport.whatami != zenoh.WhatAmI.ROUTER:
            return
        router = str(event.transport.zid)
        with self._met:
            if event.kind == zenoh.SampleKind.PUT:
                self._routers.add(router)
            else:
                self._routers.discard(router)
            self._met.notify_all()
        self._report_router()

    def _report_router(self) -> None:
        """Report whether there is a router, if that has changed."""
        with self._met:
            up = self.up
            if up is self._reported_up or self._closed:
                return
            self._reported_up = up
        if up:
            self._notifier.notify(NoticeKind.UP, "connected to a router")
        else:
            where = " or ".join(self._router)
            self._notifier.notify(
                NoticeKind.DOWN, f"no router at {where}, still trying; `llfsm router` starts one"
            )


class _ZenohNode(Node):
    def __init__(
        self,
        owner: ZenohTransport,
        names: Names,
        token: str,
        connection: Connection,
        numbers: itertools.count[int],
    ) -> None:
        super().__init__(owner, names)
        self._token_key = token
        self._connection = connection
        self._numbers = numbers
        self._token = connection.session.liveliness().declare_token(token)

    def _make(self, end: Endpoint, of: Any, qos: Qos, *callback: Any) -> ZenohEndpoint:
        token = endpoint_token(self._token_key, next(self._numbers), end, of.dds_name)
        return ENDPOINTS[end.role](Place(self, self._connection, token, end), of, qos, *callback)

    def _close(self) -> None:
        self._token.undeclare()
