"""What publishers, subscriptions, clients and servers over Zenoh have in common."""

from __future__ import annotations

from typing import NamedTuple

import xxhash
import zenoh

from ..graph import Endpoint
from ..notices import Notifier
from ..timer_thread import TimerThread
from .attachment import GID_SIZE
from .discovery import Discovery
from .tokens import data_key, endpoint_token

__all__ = ["Connection", "ZenohEndpoint"]


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
