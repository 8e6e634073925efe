"""One host's part of mirroring: collecting batches to send, and applying those that arrive.

It uses no network and no clock of its own: bytes come in and go out, and clocks are passed in. So
the daemon, a connected process and the simulation run the same code.
"""

from __future__ import annotations

import os
import socket
import threading
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import NamedTuple, TypeVar

import msgspec

from ..errors import BoardClosedError, WhiteboardError
from ..messages.llfsm import BELL, REQUESTS, Bell, MirrorStatus
from .batches import (
    Batch,
    Declaration,
    Heartbeat,
    StateQuery,
    Value,
    decoder,
    divide,
    encode,
)
from .merge import Version
from .peers import Peers
from .refusals import Refusals, Refused
from .routes import Route
from .settings import Settings, matcher
from .store import Outcome, Store

__all__ = ["Exchange", "Query"]

T = TypeVar("T")

_BATCHES = decoder(Batch)
_HEARTBEATS = decoder(Heartbeat)
_QUERIES = decoder(StateQuery)
_MAX_LISTED = 50  # hosts, and kinds of refusals, in a status
_MAX_UNKNOWN = 4096  # types of senders to keep track of


class Query(NamedTuple):
    """A query to send to another host."""

    host: int
    gaps: int  # of that host; passed back at the end of the reply
    data: bytes


@dataclass
class _Totals:
    """The counters of the status."""

    left: int = 0
    entered: int = 0
    conflicts: int = 0
    held_back: int = 0
    at_ns: int = 0


class _Held(NamedTuple):
    """A message that came too soon after the previous one of its slot."""

    sender: int
    route: Route
    value: Value


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
        self._period_ns = settings.period_ns()
        self._leaves = matcher(settings.leave)
        self._enters = matcher(() if settings.read_only else settings.enter)
        self._lock = threading.RLock()
        self._born = wall_ns()
        self._number = 0
        self._routes: dict[str, Route] = {}
        self._changed: dict[str, Route] = {}  # in the order of the changes
        self._held: dict[str, _Held] = {}
        self._busy_ns = 0  # until when an arriving message may be held back
        self._unknown: set[str] = set()  # slots whose type at a sender has to be queried
        self._clashes: dict[tuple[str, int], str] = {}  # by slot and type
        self._peers = Peers()
        self._refusals = Refusals()
        self._totals = _Totals()
        self._reported = _Totals(at_ns=now_ns())

    # ---- Sending ----------------------------------------------------------------------------

    def collect(self, slots: Iterable[str] = (), *, ignore_rates: bool = False) -> list[bytes]:
        """Return batches to send: the newest message of each slot that has changed and may leave.

        `slots` are those that may have changed since the last call. A slot waits until its rate
        permits it to leave, unless `ignore_rates`.
        """
        with self._lock:
            store, changed = self._store, self._changed
            for name in slots:
                route = self._routes.get(name) or self._usable_route(name)
                if route is not None and route.leaves and route.cell.has_news():
                    changed[name] = route
            if store.news:
                routes = {name: self._route(name) for name in store.news}
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
            self._totals.left += len(values)
            return self._pack(values, declarations) if values else []

    def batches_sent(self) -> None:
        """Record that the collected batches were sent."""
        with self._lock:
            self._store.note()

    def _route(self, name: str) -> Route:
        """Return the route of a slot that is on the board."""
        route = self._routes.get(name)
        if route is None:
            leaves, enters, period = self._leaves(name), self._enters(name), self._period_ns(name)
            route = self._routes[name] = Route(self._store.cell(name), leaves, enters, period)
        return route

    def _usable_route(self, name: str) -> Route | None:
        """Return the route of a slot, or None if its record on the board is unusable."""
        try:
            return self._route(name)
        except Refused as refused:
            self._refusals.add(f"unusable: {name}", str(refused))
            return None

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
            peers = self._peers.to_query(self._now_ns())
            data = encode(StateQuery(tuple(self._known()))) if peers else b""
            return [Query(peer.sender, peer.gaps, data) for peer in peers]

    def _known(self) -> list[tuple[str, Version]]:
        """Return the versions of the messages that other hosts may have, too."""
        shared = (
            (name, self._store.version(route.cell))
            for name, route in self._all_routes()
            if (route.leaves or route.enters) and name not in self._unknown
        )
        known = [(name, version) for name, version in shared if version is not None]
        self._store.note()
        return known

    def _all_routes(self) -> list[tuple[str, Route]]:
        routes = ((of.name, self._usable_route(of.name)) for of in self._store.board.slots())
        return [(name, route) for name, route in routes if route is not None]

    def reply(self, data: bytes) -> list[bytes]:
        """Return the reply to another host's query: the messages that are newer here."""
        with self._lock:
            query = self._decode(_QUERIES, data, "query")
            if query is None:
                return []
            known, store = dict(query.known), self._store
            newer = [
                route.cell
                for name, route in self._all_routes()
                if route.leaves
                and (version := store.version(route.cell)) is not None
                and (name not in known or version > known[name])
            ]
            values = [value for value in map(store.latest, newer) if value is not None]
            store.note()
            return self._pack(values, list(map(store.declaration, newer)), counted=False)

    # ---- Receiving --------------------------------------------------------------------------

    def receive_batch(self, data: bytes) -> None:
        """Handle a batch."""
        with self._lock:
            batch = self._decode(_BATCHES, data, "batch")
            if batch is not None and batch.sender != self._store.host:
                self._apply(batch)
                self._peers.receive(batch, self._now_ns(), self._wall_ns())

    def receive_heartbeat(self, data: bytes) -> bool:
        """Handle a heartbeat; return whether it is the first one of that host."""
        with self._lock:
            heartbeat = self._decode(_HEARTBEATS, data, "heartbeat")
            if heartbeat is None or heartbeat.sender == self._store.host:
                return False
            return self._peers.receive(heartbeat, self._now_ns(), self._wall_ns())

    def receive_reply(self, data: bytes) -> None:
        """Handle one part of a reply."""
        with self._lock:
            batch = self._decode(_BATCHES, data, "reply")
            if batch is not None:
                self._apply(batch)

    def end_reply(self, query: Query, *, complete: bool = True) -> None:
        """Record that all parts of a reply have arrived, or that none will."""
        with self._lock:
            self._peers.end_reply(query.host, query.gaps if complete else 0)

    def _decode(self, decoder: msgspec.msgpack.Decoder[T], data: bytes, what: str) -> T | None:
        try:
            return decoder.decode(data)
        except (msgspec.DecodeError, ValueError, RecursionError) as error:
            self._refusals.add(f"malformed {what}", f"malformed {what}: {error}")
            return None

    def _apply(self, batch: Batch) -> None:
        declared = {d.slot: d for d in batch.declarations} if batch.declarations else {}
        for value in batch.values:
            name = value.slot
            try:
                route = self._routes.get(name)
                if route is None or route.cell.kind != value.kind or not route.enters:
                    route = self._find_route(batch.sender, value, declared.get(name))
                if route is not None:
                    self._enter(batch.sender, route, value)
            except BoardClosedError:
                return
            except (Refused, WhiteboardError) as error:
                self._refuse(batch.sender, name, error)

    def _find_route(
        self, sender: int, value: Value, declaration: Declaration | None
    ) -> Route | None:
        """Return the route of a slot, made if necessary, if the sender's type is the board's.

        None if the slot may not enter, or the sender has to be queried for its type.
        """
        name = value.slot
        if not self._enters(name):
            why = "the board is read-only" if self._settings.read_only else "not listed"
            self._refusals.add(f"{why}: {name}", f"slot {name!r}: {why}")
            return None
        if declaration is not None:
            self._unknown.discard(name)
            if not self._store.has(name):
                self._make(declaration)
        if name in self._routes or self._store.has(name):
            route = self._route(name)
            if route.cell.kind == value.kind:
                return route
            if declaration is not None and len(self._clashes) < _MAX_UNKNOWN:
                self._clashes[name, value.kind] = self._store.clash(route.cell, declaration)
            clash = self._clashes.get((name, value.kind))
            if clash is not None:
                raise Refused(clash)
        if len(self._unknown) < _MAX_UNKNOWN:
            self._unknown.add(name)
            self._peers.miss(sender)
        return None

    def _make(self, declaration: Declaration) -> None:
        if declaration.capacity > self._settings.largest:
            raise Refused(
                f"slot {declaration.slot!r}: its capacity of {declaration.capacity} bytes exceeds "
                f"this host's limit of {self._settings.largest}"
            )
        self._store.declare(declaration)

    def _refuse(self, sender: int, slot: str, error: Refused | WhiteboardError) -> None:
        why = f"from {sender:016x}" if isinstance(error, Refused) else "no room"
        self._refusals.add(f"{why}: {slot}", str(error))

    def _enter(self, sender: int, route: Route, value: Value) -> None:
        """Add a message to the board, or hold it back if its slot arrives too often."""
        now_ns, slot = self._now_ns(), value.slot
        if now_ns < route.arrivals.due_ns:
            self._totals.held_back += 1
            held = self._held.get(slot)
            if held is None or held.value.version < value.version:
                self._held[slot] = _Held(sender, route, value)
            return
        outcome = self._store.enter(route.cell, value)
        if outcome is Outcome.OLDER:
            self._totals.conflicts += 1
        elif outcome is Outcome.ENTERED:
            route.arrivals.record(now_ns)
            self._busy_ns = max(self._busy_ns, route.arrivals.due_ns)
            self._totals.entered += 1
            if slot.startswith(REQUESTS):  # bells are not mirrored: one might arrive first
                self._store.board.add_message(BELL, Bell())

    def enter_held(self) -> None:
        """Add the messages that were held back long enough."""
        if not self._held:
            return
        with self._lock:
            now_ns = self._now_ns()
            for slot, held in list(self._held.items()):
                if held.route.arrivals.due_ns <= now_ns:
                    del self._held[slot]
                    try:
                        self._enter(*held)
                    except (Refused, WhiteboardError) as error:
                        self._refuse(held.sender, slot, error)

    def refuse(self, what: str, why: str) -> None:
        """Record something that was refused before it reached the exchange."""
        with self._lock:
            self._refusals.add(f"{what}: {why}", f"{what}: {why}")

    # ---- Status -----------------------------------------------------------------------------

    def due_ns(self) -> int | None:
        """Return when the next waiting message may leave or enter; None if none waits."""
        with self._lock:
            if not (self._changed or self._held or self._busy_ns):
                return None
            due = [route.departures.due_ns for route in self._changed.values()]
            due += [held.route.arrivals.due_ns for held in self._held.values()]
            if self._now_ns() < self._busy_ns:
                due.append(self._busy_ns)
            else:
                self._busy_ns = 0
            return min(due, default=None)

    def status(self) -> MirrorStatus:
        """Return the status; its rates are averages since the last call."""
        with self._lock:
            now_ns, totals, before = self._now_ns(), self._totals, self._reported
            seconds = max((now_ns - before.at_ns) / 1e9, 1e-9)
            self._reported = replace(totals, at_ns=now_ns)
            return MirrorStatus(
                host=f"{self._store.host:016x}",
                pid=os.getpid(),
                slots=sum(route.leaves for _, route in self._all_routes()),
                left=totals.left,
                entered=totals.entered,
                leave_rate=round((totals.left - before.left) / seconds, 1),
                enter_rate=round((totals.entered - before.entered) / seconds, 1),
                conflicts=totals.conflicts,
                held_back=totals.held_back,
                peers=tuple(peer.status(now_ns) for peer in self._peers)[:_MAX_LISTED],
                refused=self._refusals.report()[:_MAX_LISTED],
                partition_s=self._settings.guard.partition_s,
            )
