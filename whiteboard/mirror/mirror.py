"""A mirrored board: the exchange and the network, in a loop that waits on the board."""

from __future__ import annotations

import secrets
import threading
import time
from collections.abc import Callable

from ..board import Board
from ..messages.llfsm import MirrorStatus
from .exchange import Exchange, Query
from .network import Network
from .settings import Settings
from .store import Store
from .version_log import VersionLog

__all__ = ["Mirror"]

_TICK_S = 0.005  # between two batches: changes in between travel together
_HEARTBEAT_S = 0.25
_STATUS_S = 1.0
_SETTLE_S = 0.02  # from a connection to knowing the other host's subscriptions


class Mirror:
    """Mirrors one board until it is closed.

    Args:
        board: of any kind; its name is the one by which its hosts find each other.
        settings: see :class:`.Settings`.
        versions: the known versions of the board's messages.
        host: the id of this host; random by default.
        mode: see :class:`.Network`.

    """

    def __init__(
        self,
        board: Board,
        settings: Settings,
        versions: VersionLog,
        *,
        host: int | None = None,
        mode: str = "peer",
    ) -> None:
        host = secrets.randbits(63) if host is None else host
        self._board = board
        self._watch = board.watcher()
        store = Store(board, host, _wall_ns, versions, lambda: time.time_ns() + settings.ahead_ns)
        self._exchange = Exchange(store, settings, time.monotonic_ns, time.time_ns)
        self._stop = threading.Event()
        self._replied = threading.Event()
        self._network = Network(board.name, host, settings, mode)
        self._network.join(self)

    def run(self, publish: Callable[[MirrorStatus], None] = lambda _: None) -> None:
        """Mirror until stopped or the board is removed; pass a status to `publish` each second."""
        heartbeat = status = 0.0
        while not self._stop.is_set() and self._board.alive:
            now = time.monotonic()
            if now >= heartbeat:
                heartbeat = now + _HEARTBEAT_S
                self._network.send_heartbeat(self._exchange.heartbeat())
                self._send_queries()
            if now >= status:
                status = now + _STATUS_S
                publish(self._exchange.status())
            self._exchange.enter_held()
            due_ns = self._exchange.due_ns()
            due = heartbeat if due_ns is None else min(heartbeat, due_ns / 1e9)
            if self._send(self._exchange.collect(self._watch(max(0, due - time.monotonic())))):
                time.sleep(_TICK_S)  # in a wait, a signal's handler could not call `stop`
        self._send(self._exchange.collect(self._watch(0), ignore_rates=True))

    @property
    def listens(self) -> tuple[str, ...]:
        """The endpoints where other hosts reach this one."""
        return self._network.listens

    def stop(self) -> None:
        """Let :meth:`run` send what is left and return, soon."""
        self._stop.set()

    def close(self) -> None:
        """Leave the network; call it when :meth:`run` has returned."""
        self._network.close()

    def wait_for_reply(self, timeout_s: float) -> bool:
        """Wait until another host has sent its messages; return whether one did in time."""
        return self._replied.wait(timeout_s)

    def _send(self, batches: list[bytes]) -> bool:
        for data in batches:
            self._network.send_batch(data)
        self._exchange.batches_sent()
        return bool(batches)

    def _send_queries(self) -> None:
        for query in self._exchange.queries():
            self._network.send_query(query)

    def refuse(self, what: str, why: str) -> None:
        """Count something that the network has refused, and log it once."""
        self._exchange.refuse(what, why)

    def refusals(self) -> list[str]:
        """Return what was refused, the most frequent first."""
        return [refusal.what for refusal in self._exchange.status().refused]

    # ---- In the network's threads -----------------------------------------------------------

    def receive_link(self) -> None:
        """Announce this host to one that has just connected, so that it queries this one."""
        self._stop.wait(_SETTLE_S)
        self._network.send_heartbeat(self._exchange.heartbeat())

    def receive_batch(self, data: bytes, name: str) -> None:
        """Handle a batch."""
        self._exchange.receive_batch(data, name)
        self._send_queries()

    def receive_heartbeat(self, data: bytes, name: str) -> None:
        """Handle a heartbeat; answer the first one, so that its sender need not wait for ours."""
        if self._exchange.receive_heartbeat(data, name):
            self._network.send_heartbeat(self._exchange.heartbeat())
        self._send_queries()

    def receive_query(self, data: bytes, name: str) -> list[bytes]:
        """Return the reply to a query, in parts."""
        return self._exchange.reply(data, name)

    def receive_reply(self, data: bytes, name: str) -> None:
        """Handle one part of a reply."""
        self._exchange.receive_reply(data, name)

    def end_reply(self, query: Query, *, complete: bool) -> None:
        """Handle the end of a reply."""
        self._exchange.end_reply(query, complete=complete)
        if complete:
            self._replied.set()


def _wall_ns(stamp_ns: int) -> int:
    """Return the time since 1970 of a stamp of the monotonic clock; never in the future."""
    return time.time_ns() - max(0, time.monotonic_ns() - stamp_ns)
