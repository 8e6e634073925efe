"""A board's hosts as a Zenoh session reaches them: publishing, queries and their replies."""

from __future__ import annotations

import logging
from collections.abc import Callable
from contextlib import suppress
from threading import Thread
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

from ..errors import BoardClosedError, NetworkError
from .batches import VERSION
from .exchange import Query
from .settings import Settings
from .zenoh_config import LEASE_MS, configure, endpoints
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

    def receive_batch(self, data: bytes) -> None:
        """Handle a batch."""

    def receive_heartbeat(self, data: bytes) -> None:
        """Handle a heartbeat."""

    def receive_query(self, data: bytes) -> list[bytes]:
        """Return the reply to another host's query, in parts."""

    def receive_reply(self, data: bytes) -> None:
        """Handle one part of the reply to a query of ours."""

    def end_reply(self, query: Query, *, complete: bool) -> None:
        """Handle the end of a reply; it is `complete` unless none arrived."""


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
        self._root = f"llfsm/{VERSION}/{board}"
        self._host = host
        config = configure(settings, mode)
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
        # All hosts share one key: Zenoh computes the route of a key that is subscribed to by its
        # own name once, and the route of one that matches a wildcard for each message.
        self._batches = self._session.declare_publisher(f"{self._root}/batches", **outgoing)
        self._heartbeats = self._session.declare_publisher(f"{self._root}/beats", **outgoing)
        self._declared: list[Any] = []
        self._threads: list[Thread] = []

    def join(self, receiver: Receiver) -> None:
        """Start to receive from other hosts, and to answer them."""
        import zenoh
        from zenoh.handlers import FifoChannel

        self._receiver = receiver
        session, root = self._session, self._root
        remote: dict[str, Any] = {"allowed_origin": zenoh.Locality.REMOTE}
        batch = callback_in_receiver(receiver.receive_batch)
        heartbeat = callback_in_receiver(receiver.receive_heartbeat)
        queries = session.declare_queryable(
            f"{root}/state/{self._host:016x}", FifoChannel(_MAX_PENDING)
        )
        links = session.info.declare_link_events_listener(FifoChannel(_MAX_PENDING), history=True)
        self._declared += [
            session.declare_subscriber(f"{root}/batches", batch, **remote),
            session.declare_subscriber(f"{root}/beats", heartbeat, **remote),
            queries,
            links,
        ]
        self._serve(queries.handler.recv, self._answer)
        self._serve(links.handler.recv, self._link)

    def _serve(self, take: Callable[[], T], handle: Callable[[T], None]) -> None:
        """Handle slow events in a thread of their own, until their source is closed."""
        import zenoh

        def run() -> None:
            while True:
                try:
                    event = take()
                except zenoh.ZError:
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
                self._receiver.receive_reply(reply.ok.payload.to_bytes())

        def end() -> None:
            self._receiver.end_reply(query, complete=replied)

        self._session.get(
            f"{self._root}/state/{query.source.host:016x}",
            Callback(receive, end, indirect=False),  # otherwise Zenoh starts a thread a call
            payload=query.data,
            timeout=_REPLY_TIMEOUT_S,
            consolidation=ConsolidationMode.NONE,  # otherwise only the last part arrives
        )

    def _answer(self, query: zenoh.Query) -> None:
        with query:
            payload = query.payload
            data = b"" if payload is None else payload.to_bytes()
            for part in self._receiver.receive_query(data):
                query.reply(query.key_expr, part)

    def _link(self, event: zenoh.LinkEvent) -> None:
        from zenoh import SampleKind

        if event.kind == SampleKind.PUT:
            if not limit_link(event.link, LEASE_MS):
                _log.debug("no socket found for %s; it keeps Zenoh's time limits", event.link)
            self._receiver.receive_link()

    def close(self) -> None:
        """Leave the network; nothing is received any more."""
        for declared in self._declared:
            declared.undeclare()
        for thread in self._threads:
            thread.join()
        self._session.close()
