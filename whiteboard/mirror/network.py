"""A board's hosts as a Zenoh session reaches them: publishing, queries and their replies."""

from __future__ import annotations

import logging
from collections.abc import Callable
from contextlib import suppress
from threading import Condition, Thread
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

from ..errors import BoardClosedError, NetworkError
from .batches import VERSION
from .exchange import Query
from .keys import Keys, asker_in, name_in, version_in
from .settings import Settings
from .zenoh_config import LEASE_MS, certificate_name, configure, endpoints
from .zenoh_internals import callback_in_receiver, error_text, limit_link, use_few_threads

if TYPE_CHECKING:
    import zenoh

__all__ = ["Network", "Receiver"]

T = TypeVar("T")

_REPLY_TIMEOUT_S = 5.0
_MAX_PENDING = 64  # queries that wait to be answered

_log = logging.getLogger("llfsm.mirror")


class Receiver(Protocol):
    """Receives what arrives from a network, in Zenoh's threads."""

    def receive_link(self) -> None:
        """Handle a new connection."""

    # The name of the other host is the one in its certificate; empty if that is not proven.

    def receive_batch(self, data: bytes, name: str) -> None:
        """Handle a batch."""

    def receive_heartbeat(self, data: bytes, name: str) -> None:
        """Handle a heartbeat."""

    def receive_query(self, data: bytes, name: str) -> list[bytes]:
        """Return the reply to another host's query, in parts."""

    def receive_reply(self, data: bytes, name: str) -> None:
        """Handle one part of the reply to a query of ours."""

    def end_reply(self, query: Query, *, complete: bool) -> None:
        """Handle the end of a reply; it is `complete` unless none arrived."""

    def refuse(self, what: str, why: str) -> None:
        """Count something that was refused."""


class _Queries:
    """The queries that wait for an answer, one of each host: who asks often displaces nobody."""

    def __init__(self) -> None:
        self._waiting: dict[str, zenoh.Query] = {}
        self._closed = False
        self._changed = Condition()

    def put(self, query: zenoh.Query) -> None:
        """Let a query wait, in place of an earlier one; dropped if too many hosts ask."""
        key = str(query.key_expr)
        with self._changed:
            if key in self._waiting or len(self._waiting) < _MAX_PENDING:
                self._waiting[key] = query
                self._changed.notify()

    def take(self) -> zenoh.Query:
        """Wait for a query; raise EOFError when closed."""
        with self._changed:
            self._changed.wait_for(lambda: self._waiting or self._closed)
            if self._closed:
                raise EOFError
            return self._waiting.pop(next(iter(self._waiting)))

    def close(self) -> None:
        """Drop what waits, and end the wait."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()


class Network:
    """The hosts of one board, as a Zenoh session reaches them.

    Args:
        board: the board's name, by which hosts find each other.
        host: the id of this host.
        settings: endpoints and further configuration of Zenoh.
        mode: ``peer``, or ``client`` for a process that connects to one host and relies on it.

    Raise :class:`.NetworkError` if Zenoh is not installed or cannot open the session.

    """

    def __init__(self, board: str, host: int, settings: Settings, mode: str = "peer") -> None:
        use_few_threads()
        try:
            import zenoh
        except ImportError as error:
            raise NetworkError(
                "Zenoh is not installed; install llfsm with it: pip install 'llfsm[hosts]'"
            ) from error
        self._access = settings.access
        config = configure(settings, mode)
        self._keys = Keys(board, host, certificate_name(config))
        self.listens = endpoints(config, "listen")
        """The endpoints where other hosts reach this one."""
        try:
            self._session: Any = zenoh.open(config)
        except zenoh.ZError as error:
            where = ", ".join((*self.listens, *endpoints(config, "connect")))
            raise NetworkError(f"cannot open {where}: {error_text(error)}") from error
        # Never wait for a host that does not read: the receiver notices the missing number.
        outgoing: dict[str, Any] = {
            "congestion_control": zenoh.CongestionControl.DROP,
            "express": True,
            "allowed_destination": zenoh.Locality.REMOTE,
        }
        self._batches = self._session.declare_publisher(self._keys.batches, **outgoing)
        self._heartbeats = self._session.declare_publisher(self._keys.beats, **outgoing)
        self._queries = _Queries()
        self._declared: list[Any] = []
        self._threads: list[Thread] = []

    def join(self, receiver: Receiver) -> None:
        """Start to receive from other hosts, and to answer them."""
        import zenoh
        from zenoh.handlers import Callback, FifoChannel

        self._receiver = receiver
        session, keys = self._session, self._keys
        remote: dict[str, Any] = {"allowed_origin": zenoh.Locality.REMOTE}
        batch = callback_in_receiver(self._receive_batch)
        heartbeat = callback_in_receiver(self._receive_heartbeat)
        queries = Callback(self._queries.put, indirect=False)
        links = session.info.declare_link_events_listener(FifoChannel(_MAX_PENDING), history=True)
        self._declared += [
            session.declare_subscriber(keys.all_batches, batch, **remote),
            session.declare_subscriber(keys.all_beats, heartbeat, **remote),
            session.declare_queryable(keys.queries, queries),
            links,
        ]
        self._serve(self._queries.take, self._answer)
        self._serve(links.handler.recv, self._link)

    def _name(self, key: str) -> str:
        """Return the name of the host that has used a key; empty if nothing proves it."""
        return name_in(key) if self._access else ""

    def _receive_batch(self, key: str, data: bytes) -> None:
        self._receiver.receive_batch(data, self._name(key))

    def _receive_heartbeat(self, key: str, data: bytes) -> None:
        version = version_in(key)
        if version == str(VERSION):
            self._receiver.receive_heartbeat(data, self._name(key))
        else:
            self._receiver.refuse(
                f"a host with version {version} of the protocol",
                f"this host has version {VERSION}; install the same llfsm on both",
            )

    def _serve(self, take: Callable[[], T], handle: Callable[[T], None]) -> None:
        """Handle slow events in a thread of their own, until their source is closed."""
        import zenoh

        def run() -> None:
            while True:
                try:
                    event = take()
                except (zenoh.ZError, EOFError):
                    return
                with suppress(BoardClosedError, zenoh.ZError):  # the board or the asker is gone
                    handle(event)

        # Zenoh would start a thread, too, but the process would wait for that one when it ends.
        self._threads.append(Thread(target=run, name=f"mirror {handle.__name__}", daemon=True))
        self._threads[-1].start()

    def send_batch(self, data: bytes) -> None:
        """Send a batch to all other hosts."""
        self._batches.put(data)

    def send_heartbeat(self, data: bytes) -> None:
        """Send a heartbeat to all other hosts."""
        self._heartbeats.put(data)

    def send_query(self, query: Query) -> None:
        """Send a query to one host; the receiver gets the reply."""
        from zenoh import ConsolidationMode
        from zenoh.handlers import Callback

        replied = False

        def receive(reply: zenoh.Reply) -> None:
            nonlocal replied
            if reply.ok is not None:
                replied = True
                self._receiver.receive_reply(reply.ok.payload.to_bytes(), query.source.name)

        def end() -> None:
            self._receiver.end_reply(query, complete=replied)

        self._session.get(
            self._keys.query(query.source),
            Callback(receive, end, indirect=False),  # otherwise Zenoh starts a thread a call
            payload=query.data,
            timeout=_REPLY_TIMEOUT_S,
            consolidation=ConsolidationMode.NONE,  # otherwise only the last part arrives
        )

    def _answer(self, query: zenoh.Query) -> None:
        with query:
            payload = query.payload
            data = b"" if payload is None else payload.to_bytes()
            name = asker_in(str(query.key_expr)) if self._access else ""
            for part in self._receiver.receive_query(data, name):
                query.reply(query.key_expr, part)

    def _link(self, event: zenoh.LinkEvent) -> None:
        from zenoh import SampleKind

        if event.kind == SampleKind.PUT:
            if not limit_link(event.link, LEASE_MS):
                _log.debug("no socket found for %s; it keeps Zenoh's time limits", event.link)
            name = event.link.auth_identifier
            if self._access and name not in self._access:
                self._receiver.refuse("a connection", f"`access` does not list {name!r}")
            self._receiver.receive_link()

    def close(self) -> None:
        """Leave the network; nothing is received any more."""
        for declared in self._declared:
            declared.undeclare()
        self._queries.close()
        for thread in self._threads:
            thread.join()
        self._session.close()
