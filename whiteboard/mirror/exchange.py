"""One host's part of mirroring: collecting batches to send, and applying those that arrive.

It uses no network and no clock of its own: bytes come in and go out, and clocks are passed in. So
the daemon, a connected process and the simulation run the same code.
"""

from __future__ import annotations

import os
import socket
import threading
from collections.abc import Callable, Iterable
from typing import NamedTuple, TypeVar

import msgspec

from ..messages.llfsm import MirrorStatus
from .arrivals import Arrivals
from .batches import (
    Batch,
    Declaration,
    Heartbeat,
    ReceivedBatch,
    StateQuery,
    Value,
    decoder,
    divide,
    encode,
)
from .merge import Version
from .peers import Peers, Source
from .quotas import Quotas
from .refusals import Refusals
from .routes import Route, Routes
from .settings import Settings
from .store import Store

__all__ = ["Exchange", "Query"]

T = TypeVar("T")

_BATCHES = decoder(ReceivedBatch)
_HEARTBEATS = decoder(Heartbeat)
_QUERIES = decoder(StateQuery)
_DONE = object()
_MAX_LISTED = 50  # hosts, and kinds of refusals, in a status


class Query(NamedTuple):
    """A query to send to another host."""

    source: Source
    gaps: int  # of that host; passed back at the end of the reply
    data: bytes


class _Reported(NamedTuple):
    """What the previous status has counted."""

    left: int
    entered: int
    at_ns: int


class Exchange:
    """What a board sends and receives. Threads may share it.

    Args:
        store: the board, with versions.
        settings: which slots leave and enter, and how often.
        now_ns: a monotonic clock.
        wall_ns: the host's clock: the time since 1970.

    """

    def __init__(
        self,
        store: Store,
        settings: Settings,
        now_ns: Callable[[], int],
        wall_ns: Callable[[], int],
    ) -> None:
        self._store = store
        self._settings = settings
        self._now_ns = now_ns
        self._wall_ns = wall_ns
        self._lock = threading.Lock()
        self._born = wall_ns()
        self._number = 0
        self._changed: dict[str, Route] = {}  # in the order of the changes
        self._left = 0
        self._peers = Peers()
        self._refusals = Refusals()
        self._routes = Routes(store, settings, self._refusals)
        self._quotas = Quotas(settings.quota)
        self._arrivals = Arrivals(
            store,
            settings,
            self._routes,
            self._peers,
            self._quotas,
            self._refusals,
            now_ns,
            wall_ns,
        )
        self._reported = _Reported(0, 0, now_ns())

    # ---- Sending ----------------------------------------------------------------------------

    def collect(self, slots: Iterable[str] = (), *, ignore_rates: bool = False) -> list[bytes]:
        """Return batches to send: the newest message of each slot that has changed and may leave.

        `slots` are those that may have changed since the last call. A slot waits until its rate
        permits it to leave, unless `ignore_rates`.
        """
        with self._lock:
            store, changed = self._store, self._changed
            for name in slots:
                route = self._routes.usable(name)
                if route is not None and route.leaves and route.cell.has_news():
                    changed[name] = route
            if store.news:
                routes = {name: self._routes.get(name) for name in store.news}
                changed.update((name, r) for name, r in routes.items() if r.leaves)
            now_ns, values, declarations = self._now_ns(), [], []
            for name, route in list(changed.items()):
                if now_ns < route.departures.due_ns and not ignore_rates:
                    continue
                del changed[name]
                value = store.latest(route.cell)
                if value is None or value.version.host != store.host or value.version == route.sent:
                    continue
                if route.sent is None:
                    declarations.append(store.declaration(route.cell))
                route.sent = value.version
                route.departures.record(now_ns)
                values.append(value)
            store.news.clear()  # each is in `values` or still in `changed`
            self._left += len(values)
            return self._pack(values, declarations) if values else []

    def batches_sent(self) -> None:
        """Record that the collected batches were sent."""
        with self._lock:
            self._store.note()

    def _pack(
        self, values: list[Value], declarations: list[Declaration], *, counted: bool = True
    ) -> list[bytes]:
        packed = []
        for part in divide(values):
            self._number += counted
            declared: tuple[Declaration, ...] = ()
            if declarations:
                names = {value.slot for value in part}
                declared = tuple(d for d in declarations if d.slot in names)
            head = self._store.host, self._born, self._number, self._wall_ns()
            packed.append(encode(Batch(*head, tuple(part), declared)))
        return packed

    def heartbeat(self) -> bytes:
        """Return a heartbeat."""
        with self._lock:
            store, name = self._store, socket.gethostname()[:255]
            return encode(Heartbeat(store.host, self._born, self._number, self._wall_ns(), name))

    def queries(self) -> list[Query]:
        """Return the queries to send now."""
        with self._lock:
            if self._settings.read_only or not self._settings.enter:
                return []
            now_ns = self._now_ns()
            peers = self._peers.to_query(now_ns, self._wall_ns())
            if not peers:
                return []
            known = tuple(self._known())
            data = encode(StateQuery(known))
            for peer in peers:  # who pretends to lose messages is not queried all the time
                self._quotas.account(peer.source.name).charge(now_ns, messages=len(known))
            return [Query(peer.source, peer.gaps, data) for peer in peers]

    def _known(self) -> list[tuple[str, Version]]:
        """Return the versions of the messages that other hosts may have, too."""
        shared = (
            (name, self._store.version(route.cell))
            for name, route in self._routes.all()
            if (route.leaves or route.enters) and name not in self._arrivals.unknown
        )
        known = [(name, version) for name, version in shared if version is not None]
        self._store.note()
        return known

    def reply(self, data: bytes, name: str = "") -> list[bytes]:
        """Return the reply to another host's query: the messages that are newer here.

        `name` is the one in its certificate. What it makes this host send counts as its traffic.
        """
        query = self._admit(_QUERIES, data, name, "query")
        if query is None:
            return []
        with self._lock:
            known, store, routes = dict(query.known), self._store, self._routes.all()
            newer = [
                route.cell
                for slot, route in routes
                if route.leaves
                and (version := store.version(route.cell)) is not None
                and (slot not in known or version > known[slot])
            ]
            values = [value for value in map(store.latest, newer) if value is not None]
            store.note()
            parts = self._pack(values, list(map(store.declaration, newer)), counted=False)
            size = sum(map(len, parts))
            self._quotas.account(name).charge(self._now_ns(), messages=len(routes), size=size)
            return parts

    # ---- Receiving --------------------------------------------------------------------------

    # Each method takes the name in the sender's certificate, which is empty if it is not known.

    def receive_batch(self, data: bytes, name: str = "") -> None:
        """Handle a batch."""
        batch = self._admit(_BATCHES, data, name, "batch")
        if batch is not None and batch.sender != self._store.host:
            source = Source(name, batch.sender)
            if self._apply(source, batch):
                with self._lock:
                    self._peers.receive(source, batch, self._now_ns(), self._wall_ns())

    def receive_heartbeat(self, data: bytes, name: str = "") -> bool:
        """Handle a heartbeat; return whether it is the first one of that host."""
        heartbeat = self._admit(_HEARTBEATS, data, name, "heartbeat")
        if heartbeat is None or heartbeat.sender == self._store.host:
            return False
        source = Source(name, heartbeat.sender)
        with self._lock:
            return self._peers.receive(source, heartbeat, self._now_ns(), self._wall_ns())

    def receive_reply(self, data: bytes, name: str = "") -> None:
        """Handle one part of a reply."""
        batch = self._admit(_BATCHES, data, name, "reply")
        if batch is not None:
            self._apply(Source(name, batch.sender), batch)

    def _apply(self, source: Source, batch: ReceivedBatch) -> bool:
        """Add the messages of a batch; return False if its sender is over its rate before the end.

        The lock is released after each, so that a batch that takes long holds nobody up.
        """
        steps, account = self._arrivals.steps(source, batch), self._quotas.account(source.name)
        while True:
            with self._lock:
                if next(steps, _DONE) is _DONE:
                    return True
                if account.is_over(self._now_ns()):
                    return False

    def end_reply(self, query: Query, *, complete: bool = True) -> None:
        """Record that all parts of a reply have arrived, or that none will."""
        with self._lock:
            self._peers.end_reply(query.source, query.gaps if complete else 0)

    def _admit(
        self, decoder: msgspec.msgpack.Decoder[T], data: bytes, name: str, what: str
    ) -> T | None:
        """Return decoded data; None if it is malformed, or over the rates of its sender."""
        with self._lock:
            if not self._quotas.account(name).admits(len(data), self._now_ns()):
                return None
        try:
            return decoder.decode(data)
        except (msgspec.DecodeError, ValueError, RecursionError) as error:
            with self._lock:
                self._refusals.add(f"malformed {what}", f"malformed {what}: {error}")
            return None

    def enter_held(self) -> None:
        """Add the messages that were held back long enough."""
        with self._lock:
            self._arrivals.enter_held()

    def refuse(self, what: str, why: str) -> None:
        """Record something that was refused before it reached the exchange."""
        with self._lock:
            self._refusals.add(f"{what}: {why}", f"{what}: {why}")

    # ---- Status -----------------------------------------------------------------------------

    def due_ns(self) -> int | None:
        """Return when the next waiting message may leave or enter; None if none waits."""
        with self._lock:
            due = [route.departures.due_ns for route in self._changed.values()]
            return min(due + self._arrivals.due_ns(), default=None)

    def status(self) -> MirrorStatus:
        """Return the status; its rates are averages since the last call."""
        with self._lock:
            arrivals, before = self._arrivals, self._reported
            now = self._reported = _Reported(self._left, arrivals.entered, self._now_ns())
            seconds = max((now.at_ns - before.at_ns) / 1e9, 1e-9)
            return MirrorStatus(
                host=f"{self._store.host:016x}",
                pid=os.getpid(),
                slots=sum(route.leaves for _, route in self._routes.all()),
                left=now.left,
                entered=now.entered,
                leave_rate=round((now.left - before.left) / seconds, 1),
                enter_rate=round((now.entered - before.entered) / seconds, 1),
                conflicts=arrivals.conflicts,
                held_back=arrivals.held_back,
                peers=tuple(peer.status(now.at_ns) for peer in self._peers)[:_MAX_LISTED],
                quotas=tuple(self._quotas.status())[:_MAX_LISTED],
                refused=self._refusals.report()[:_MAX_LISTED],
                partition_s=self._settings.guard.partition_s,
            )
