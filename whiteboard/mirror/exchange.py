"""One host's part of mirroring: collecting batches to send, and applying those that arrive.

**What is exchanged.** When a process of this host has added to a slot, the slot's newest message
leaves in a batch, one for each group of slots (see :mod:`.groups`) that another host reads, as soon
as the slot's rate permits. Batches of a group are numbered, and heartbeats repeat the last number.
Who misses a number asks that host for the group's messages, listing the versions of its own; the
reply is batches, without numbers, of what is newer there. All hosts are asked when a group is read
for the first time, after connections, and once a minute.

**Why it converges.** Versions alone decide which message a board keeps (see :mod:`.batches`), so a
batch may come twice, late or in any order. Every loss is noticed, by the next batch or heartbeat,
and a query is repeated until it is answered in full. A batch has only what was added on its
sender's host, so nothing circles; a reply has whatever is newer there, so the messages of a host
that is gone spread, too. Once no process adds any more, all readers of a slot that reach each other
hold its newest message.

**No queue grows.** What waits to leave is a set of slots, and what waits to enter one message for
each slot. A slow network or a busy host gets fewer messages, not older ones.

It uses no network and no clock of its own: bytes come in and go out, and clocks are passed in. So
the daemon, a connected process and the simulation in ``examples/mirror`` run the same code.
"""

from __future__ import annotations

import os
import socket
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, TypeVar

import msgspec

from llfsm.whiteboard.messages.llfsm import STAND_INS, MirrorStatus
from llfsm.whiteboard.mirror.arrivals import Arrivals, Route, Routes
from llfsm.whiteboard.mirror.batches import (
    Batch,
    Declaration,
    Heartbeat,
    ReceivedBatch,
    StateQuery,
    Value,
    Version,
    decoder,
    divide,
    encode,
)
from llfsm.whiteboard.mirror.groups import ENDED, EVERY_GROUP, Interest
from llfsm.whiteboard.mirror.peers import EVERY_HOST, Packet, Peers, Query, Source
from llfsm.whiteboard.mirror.quotas import Quotas, Refusals
from llfsm.whiteboard.mirror.settings import Settings
from llfsm.whiteboard.mirror.store import Store

T = TypeVar("T")
_BATCHES = decoder(ReceivedBatch)
_HEARTBEATS = decoder(Heartbeat)
_QUERIES = decoder(StateQuery)
_DONE = object()
_MAX_LISTED = 50  # hosts, and kinds of refusals, in a status
_ENDED_AT_ONCE = 1000  # names in a batch
_ANNOUNCE_NS = 2_000_000_000  # from a connection on, so that a lost announcement is repeated


@dataclass(eq=False)
class Exchange:
    """Decides what a board sends, and takes what it receives. Threads may share it.

    Of the clocks, `now_ns` is monotonic and `wall_ns` the host's: the time since 1970. `is_read`
    finds out if another host reads a group. It is called without the exchange's lock: Zenoh has
    locks of its own, and waits for this one while it holds one of them.
    """

    store: Store
    settings: Settings
    now_ns: Callable[[], int]
    wall_ns: Callable[[], int]
    is_read: Callable[[str], bool] = lambda _: True

    def __post_init__(self) -> None:
        store, settings, now_ns = self.store, self.settings, self.now_ns
        self._lock = store.lock
        self._born = self.wall_ns()
        self._numbers: Counter[str] = Counter()  # of the latest batch, by group
        self._announced_ns = 0  # the time until which all groups are announced
        self.interest = Interest(settings.eager, now_ns())
        self._changed: dict[str, Route] = {}  # in the order of the changes
        self._traffic = Traffic(now_ns())
        self._peers = Peers()
        self._refusals = Refusals()
        self._routes = Routes(store, settings, self._refusals)
        self._quotas = Quotas(settings.quota)
        self._arrivals = Arrivals(self._routes, self._peers, self._quotas, now_ns, self.wall_ns)

    # ---- Sending ----------------------------------------------------------------------------

    def collect(self, slots: Iterable[str] = (), *, ignore_rates: bool = False) -> list[Packet]:
        """Make batches to send now: the newest message of each slot that has changed and is read.

        `slots` are those that may have changed since the last call. A slot waits until its rate
        permits it to leave, unless `ignore_rates`. One that nobody reads does not leave.
        """
        store, changed = self.store, self._changed
        is_read: dict[str, bool] = {}
        with self._lock:
            self._look(slots)
            for route in changed.values():
                is_read[route.group] = False
        for group in is_read:
            is_read[group] = self.is_read(group)
        with self._lock:
            now_ns = self.now_ns()
            leaving: dict[str, tuple[list[Value], list[Declaration]]] = {}
            for name, route in list(changed.items()):
                group = route.group
                if not is_read.get(group):  # who begins to read it asks for it
                    del changed[name]
                    continue
                if now_ns < route.departures.due_ns and not ignore_rates:
                    continue
                del changed[name]
                value = store.latest(route.cell)
                store.news.pop(name, None)
                if value is None or value.version.host != store.host or value.version == route.sent:
                    continue
                if group not in leaving:
                    leaving[group] = [], []
                values, declarations = leaving[group]
                if route.sent is None:
                    declarations.append(store.declaration(route.cell))
                route.sent = value.version
                route.departures.record(now_ns)
                values.append(value)
                self._traffic.left += 1
            packets = []
            for group in self._routes.in_order(leaving) if len(leaving) > 1 else leaving:
                for data in self._pack(*leaving[group], group):
                    packets.append(Packet(group, data))
            return packets

    def ends(self) -> list[Packet]:
        """Make batches of the names that were given up here since the last call."""
        is_read = self.is_read(ENDED)
        with self._lock:
            ended = []
            for route in self._routes.take_gone():
                name, version = route.cell.slot.name, route.cell.version
                self._quotas.give_back(name)
                self._changed.pop(name, None)
                if is_read and route.leaves and version is not None:
                    ended.append(Value(name, 0, version, b""))
            parts = [ended[at : at + _ENDED_AT_ONCE] for at in range(0, len(ended), _ENDED_AT_ONCE)]
            return [Packet(ENDED, data) for part in parts for data in self._pack(part, [], ENDED)]

    def _look(self, slots: Iterable[str]) -> None:
        """Record which slots have changed: any of `slots`, and those of which there is news."""
        changed, routes, news = self._changed, self._routes, self.store.news
        for name in slots:
            if name == STAND_INS.name:
                given_way = [routes.usable(slot) for slot in self.store.give_way()]
                self.interest.ask(route.group for route in given_way if route is not None)
            route = routes.offered_by(name)
            if route is not None and route.leaves and route.cell.has_news():
                changed[name] = route
        for name in news:
            route = routes.offered_by(name)
            if route is not None and route.leaves:
                changed[name] = route
        news.clear()

    def batches_sent(self) -> None:
        """Record that the collected batches were sent."""
        with self._lock:
            self.store.note()

    def _pack(
        self, values: list[Value], declarations: list[Declaration], group: str | None
    ) -> list[bytes]:
        """Make batches, with the next numbers of a group; those of a reply have none."""
        packed, naming = [], self._routes.naming
        if naming.host:
            values = list(map(naming.leaving, values))
        for part in divide(values):
            number = 0
            if group is not None:
                number = self._numbers[group] = self._numbers[group] + 1
            declared: tuple[Declaration, ...] = ()
            if declarations:
                names = {value.slot for value in part}
                leaving = map(naming.leaving, declarations)
                declared = tuple(d for d in leaving if d.slot in names)
            head = self.store.host, self._born, number, self.wall_ns()
            packed.append(encode(Batch(*head, tuple(part), declared)))
            self._traffic.sent += len(packed[-1])
        return packed

    def groups(self, slots: Iterable[str] = ()) -> list[str]:
        """Return the groups of which this host has messages that may leave; `slots` have some."""
        with self._lock:
            for slot in slots:
                self._routes.offered_by(slot)
            return self._routes.in_order(self._routes.offered)

    def heartbeats(self) -> list[Packet]:
        """Make a heartbeat for each group that is read, and has news of this host.

        A host that receives only what is read here leaves the rest to who adds it: otherwise, all
        readers of a slot would report to each other. But it does so while hosts connect.
        """
        with self._lock:
            every = self.settings.eager or self.now_ns() < self._announced_ns
            groups = self._routes.in_order(self._routes.offered if every else self._numbers)
            if ENDED not in self._numbers:
                groups = [group for group in groups if group != ENDED]
        read = {group for group in groups if self.is_read(group)}
        with self._lock:
            head, name = (self.store.host, self._born), socket.gethostname()[:255]
            sent_ns = self.wall_ns()
            beats = [
                Packet(group, encode(Heartbeat(*head, self._numbers[group], sent_ns, name)))
                for group in groups
                if group in read
            ]
            self._traffic.sent += sum(len(beat.data) for beat in beats)
            return beats

    def begin_sending(self, group: str) -> None:
        """Have :meth:`collect` send all of a group, as another host has begun to read it."""
        with self._lock:
            routes = self._routes.of(group)
            self._changed.update((name, route) for name, route in routes if route.leaves)

    def connect(self, *, to_router: bool = False) -> None:
        """Announce all, and ask for what is received here, as hosts have just connected."""
        with self._lock:
            self._announced_ns = self.now_ns() + _ANNOUNCE_NS
            self.interest.connect(to_router)

    def read(self, slots: Iterable[str]) -> set[str]:
        """Return the groups to receive now that these slots are read; see `Interest.change`."""
        with self._lock:
            wanted = self._routes.to_receive(slots)
            if self._arrivals.entered:
                wanted.add(ENDED)
            self._peers.restart(self.interest.change(wanted))
            return self.interest.groups

    def queries(self) -> list[Query]:
        """Make the queries to send now: for new groups to all hosts, for gaps to one each."""
        with self._lock:
            if self.settings.read_only or not self.settings.enter:
                return []
            now_ns = self.now_ns()
            found = [Query(EVERY_HOST._replace(group=group), 0, self._query(group)[0])
                     for group in self.interest.take(now_ns)]  # fmt: skip
            for peer in self._peers.to_query(now_ns, self.wall_ns()):
                data, known = self._query(peer.source.group)
                # who pretends to lose messages is not queried all the time
                self._quotas.account(peer.source.name).charge(now_ns, messages=known)
                found.append(Query(peer.source, peer.gaps, data))
            return found

    def query_for_all(self) -> Query:
        """Make a query to all hosts for all groups."""
        with self._lock:
            return Query(EVERY_HOST, 0, self._query(EVERY_GROUP)[0])

    def _query(self, group: str) -> tuple[bytes, int]:
        """Make a query for a group's messages; return it, and the number of those known here."""
        known = tuple(self._known(EVERY_GROUP if group == ENDED else group))
        return encode(StateQuery(known)), len(known)

    def _known(self, group: str) -> list[tuple[str, Version]]:
        """List the versions of a group's messages that other hosts may have, too."""
        shared = (
            (route.wire, self.store.version(route.cell))
            for name, route in self._routes.of(group)
            if (route.leaves or route.enters) and name not in self._arrivals.unknown
        )
        known = [(name, version) for name, version in shared if version is not None]
        self.store.note()
        return known

    def reply(self, data: bytes, name: str = "", group: str = EVERY_GROUP) -> list[bytes]:
        """Make the reply to another host's query for a group: the messages that are newer here.

        `name` is the one in its certificate. The reply's bytes count as the traffic of that host.
        """
        query = self._admit(_QUERIES, data, name, "query")
        if query is None:
            return []
        with self._lock:
            known, store, routes = dict(query.known), self.store, self._routes.of(group)
            newer = [
                route.cell
                for _, route in routes
                if route.leaves
                and (version := store.version(route.cell)) is not None
                and not store.stands_in(route.cell)
                and (route.wire not in known or version > known[route.wire])
            ]
            values = [value for value in map(store.latest, newer) if value is not None]
            if group in (ENDED, EVERY_GROUP):
                values += self._ended(known)
            store.note()
            parts = self._pack(values, list(map(store.declaration, newer)), None)
            size = sum(map(len, parts))
            self._quotas.account(name).charge(self.now_ns(), messages=len(routes), size=size)
            return parts

    def _ended(self, known: dict[str, Version]) -> list[Value]:
        """List the messages of this host that others still have, though their names are gone."""
        ours = {wire: version for wire, version in known.items() if version.host == self.store.host}
        if not ours:
            return []
        living = set(self.store.board.living())
        names = ((self._routes.naming.local(wire), version) for wire, version in ours.items())
        return [
            Value(name, 0, version, b"")
            for name, version in names
            if name is not None and name not in living and self._routes.leaves(name)
        ]

    # ---- Receiving --------------------------------------------------------------------------

    # Each method takes the name in the sender's certificate, which is empty if it is not known, and
    # the group under whose key it was sent.

    def receive_batch(self, data: bytes, name: str = "", group: str = EVERY_GROUP) -> None:
        """Handle a batch."""
        batch = self._admit(_BATCHES, data, name, "batch")
        if batch is not None and batch.sender != self.store.host:
            source = Source(name, batch.sender, group)
            if self._apply(source, batch):
                with self._lock:
                    self._peers.receive(source, batch, self.now_ns(), self.wall_ns())

    def receive_heartbeat(self, data: bytes, name: str = "", group: str = EVERY_GROUP) -> None:
        """Handle a heartbeat."""
        heartbeat = self._admit(_HEARTBEATS, data, name, "heartbeat")
        if heartbeat is not None and heartbeat.sender != self.store.host:
            source = Source(name, heartbeat.sender, group)
            with self._lock:
                self._peers.receive(source, heartbeat, self.now_ns(), self.wall_ns())

    def receive_reply(self, data: bytes, name: str = "", group: str = EVERY_GROUP) -> None:
        """Handle one part of a reply."""
        batch = self._admit(_BATCHES, data, name, "reply")
        if batch is not None:
            self._apply(Source(name, batch.sender, group), batch)

    def _apply(self, source: Source, batch: ReceivedBatch) -> bool:
        """Add the messages of a batch; return False if its sender is over its rate before the end.

        The lock is released after each, so that a batch that takes long holds nobody up.
        """
        steps, account = self._arrivals.steps(source, batch), self._quotas.account(source.name)
        while True:
            with self._lock:
                if next(steps, _DONE) is _DONE:
                    return True
                if account.is_over(self.now_ns()):
                    return False

    def end_reply(self, query: Query, *, complete: bool = True) -> None:
        """Record that all parts of a reply have arrived, or that no more will."""
        with self._lock:
            self._peers.end_reply(query.source, query.gaps if complete else 0)

    def _admit(
        self, decoder: msgspec.msgpack.Decoder[T], data: bytes, name: str, what: str
    ) -> T | None:
        """Decode data; return None, counted, if it is malformed or its sender over a rate."""
        with self._lock:
            self._traffic.received += len(data)
            if not self._quotas.account(name).admits(len(data), self.now_ns()):
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

    def due_ns(self) -> float | None:
        """Return the time at which a waiting message may leave or enter; None if none waits."""
        with self._lock:
            due = [route.departures.due_ns for route in self._changed.values()]
            return min(due + self._arrivals.due_ns(), default=None)

    def status(self) -> MirrorStatus:
        """Fill in the status; its rates are averages since the last call."""
        with self._lock:
            arrivals, now_ns = self._arrivals, self.now_ns()
            return MirrorStatus(
                host=f"{self.store.host:016x}",
                pid=os.getpid(),
                slots=sum(route.leaves for _, route in self._routes.of(EVERY_GROUP)),
                left=self._traffic.left,
                entered=arrivals.entered,
                **self._traffic.rates(arrivals.entered, now_ns),
                conflicts=arrivals.conflicts,
                held_back=arrivals.held_back,
                peers=tuple(self._peers.status(now_ns))[:_MAX_LISTED],
                quotas=tuple(self._quotas.status())[:_MAX_LISTED],
                refused=self._refusals.report()[:_MAX_LISTED],
                partition_s=self.settings.guard.partition_s,
                name=self.settings.as_,
                fleet=self.settings.fleet,
            )


class Traffic:
    """Counts messages and bytes between hosts, without what Zenoh and the network add.

    A batch counts once, however many hosts read it: they share it as far as a router forwards it.
    """

    def __init__(self, now_ns: int) -> None:
        self.left = 0
        """Messages of slots that were sent."""
        self.sent = self.received = 0
        """Bytes of all kinds of messages between hosts."""
        self._before: dict[str, int] = {}
        self._before_ns = now_ns

    def rates(self, entered: int, now_ns: int) -> dict[str, Any]:
        """Return the rates of a :class:`.MirrorStatus`: per second, since the last call.

        So many messages of slots have `entered` so far.
        """
        counts = {
            "leave_rate": self.left,
            "enter_rate": entered,
            "sent_rate": self.sent,
            "received_rate": self.received,
        }
        seconds = max((now_ns - self._before_ns) / 1e9, 1e-9)
        before, self._before, self._before_ns = self._before, counts, now_ns
        return {
            name: round((count - before.get(name, 0)) / seconds, 1)
            for name, count in counts.items()
        }
