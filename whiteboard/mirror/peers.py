"""The other hosts whose slots are read here, and which of them to ask for missing messages.

A host numbers the batches of each group of slots by themselves, so it is followed by group. Each
time a number is missing, or the host is new, its `gaps` grow; when it has answered in full a query
that was sent at that many gaps, it has `filled` so many. It is queried until both are equal. So a
loss during a reply leads to another query, and a reply can be lost.

The addresses of the exchange are here, too: whom a message is from, what the network is to send.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from msgspec.structs import replace

from llfsm.whiteboard.messages.llfsm import PeerStatus
from llfsm.whiteboard.mirror.batches import Heartbeat, ReceivedBatch
from llfsm.whiteboard.mirror.groups import EVERY_GROUP

_RETRY_NS = 500_000_000  # a host that does not reply is queried again after this time
_FORGET_NS = 60_000_000_000  # a host that sends nothing is forgotten after this time
_MAX_WAITING = 32  # queries at a time: a host drops those that it cannot answer soon
_LOOK_NS = 1_000_000_000
_MAX_PEERS = 1000  # of one certificate; further ones are not tracked, which bounds the memory


class Source(NamedTuple):
    """The sender of a message."""

    name: str
    """In its certificate; empty if it is not known."""
    host: int
    """The id that it claims."""
    group: str = EVERY_GROUP
    """Of the slots in the message."""

    def __str__(self) -> str:
        return self.name or f"{self.host:016x}"


EVERY_HOST = Source("", -1)
"""In place of a host: all of them."""


class Packet(NamedTuple):
    """A batch or a heartbeat for all that read a group."""

    group: str
    data: bytes


class Query(NamedTuple):
    """A query to another host, or to all that have slots of a group."""

    source: Source
    gaps: int  # of that host; passed back at the end of the reply
    data: bytes


class Peer:
    """Another host, as seen in one group of slots."""

    def __init__(self, source: Source) -> None:
        self.source = source
        self.name = ""
        self.born = -1
        self.number = 0  # of its latest batch
        self.received_ns = 0
        self.lag_ns = 0
        self.received = 0
        self.lost = 0
        self.gaps = 0  # how often something was missing
        self.filled = 0  # the gaps that its replies have filled
        self.queried_ns: int | None = None
        self.missed_at_ns: int | None = None  # by this host's clock: from then on it has a gap

    def receive(self, message: ReceivedBatch | Heartbeat, now_ns: int, wall_ns: int) -> None:
        """Record a message; messages arrive in the order in which they were sent.

        A host that restarts is known by another `born`, not by a later one: its clock may have been
        set back. A late message from before its restart only causes a query too many.
        """
        self.received_ns = now_ns
        if message.born != self.born:
            self.born, self.number = message.born, message.number
            self.gaps += 1  # for the messages it had before
        else:
            missing = message.number - self.number - isinstance(message, ReceivedBatch)
            if missing > 0:
                self.lost += missing
                self.gaps += 1
            self.number = max(self.number, message.number)
        if isinstance(message, ReceivedBatch):
            self.received += 1
            self.lag_ns = wall_ns - message.sent_ns
        else:
            self.name = message.name

    @property
    def is_complete(self) -> bool:
        """True if nothing of it is missing, now or later."""
        return self.filled == self.gaps and self.missed_at_ns is None

    def is_waiting(self, now_ns: int) -> bool:
        """Check that a reply of it may still come."""
        return self.queried_ns is not None and now_ns - self.queried_ns < _RETRY_NS

    def status(self, now_ns: int) -> PeerStatus:
        """Report on it."""
        return PeerStatus(
            name=self.name,
            host=f"{self.source.host:016x}",
            silent_s=round((now_ns - self.received_ns) / 1e9, 3),
            lag_ms=round(self.lag_ns / 1e6, 3),
            received=self.received,
            lost=self.lost,
            certificate=self.source.name,
        )


class Peers:
    """The other hosts, by who they are and by group of slots."""

    def __init__(self) -> None:
        self._peers: dict[Source, Peer] = {}
        self._missing: dict[Source, None] = {}  # those that may have to be queried
        self._forget_ns = 0  # the time of the next look for those that are silent

    def __iter__(self) -> Iterator[Peer]:
        return iter(list(self._peers.values()))

    def receive(
        self, source: Source, message: ReceivedBatch | Heartbeat, now_ns: int, wall_ns: int
    ) -> None:
        """Record a message."""
        peer = self._peers.get(source)
        if peer is None:
            if sum(known.name == source.name for known in self._peers) >= _MAX_PEERS:
                return
            peer = self._peers[source] = Peer(source)
        peer.receive(message, now_ns, wall_ns)
        if peer.filled != peer.gaps:
            self._missing[source] = None

    def status(self, now_ns: int) -> list[PeerStatus]:
        """Report on each host, on all its groups together."""
        hosts: dict[Source, PeerStatus] = {}
        for peer in sorted(self, key=lambda peer: peer.received_ns):
            host, latest = peer.source._replace(group=EVERY_GROUP), peer.status(now_ns)
            before = hosts.get(host)
            if before is not None:
                latest = replace(
                    latest,
                    name=latest.name or before.name,
                    received=latest.received + before.received,
                    lost=latest.lost + before.lost,
                )
            hosts[host] = latest
        return list(hosts.values())

    def to_query(self, now_ns: int, wall_ns: int) -> list[Peer]:
        """Choose the hosts to query now: those with a gap and no recent query."""
        found = []
        if now_ns >= self._forget_ns:
            self._forget_ns = now_ns + _LOOK_NS
            for silent in [each for each in self if now_ns - each.received_ns > _FORGET_NS]:
                del self._peers[silent.source]
        waiting = sum(
            source in self._peers and self._peers[source].is_waiting(now_ns)
            for source in self._missing
        )
        for source in list(self._missing):
            peer = self._peers.get(source)
            if peer is None or peer.is_complete:
                del self._missing[source]
                continue
            if peer.missed_at_ns is not None and peer.missed_at_ns <= wall_ns:
                peer.missed_at_ns = None
                peer.gaps += 1
            if peer.filled == peer.gaps or peer.is_waiting(now_ns) or waiting >= _MAX_WAITING:
                continue
            waiting += 1
            peer.queried_ns = now_ns
            found.append(peer)
            del self._missing[source]  # to the end: the next ones have their turn before it
            self._missing[source] = None
        return found

    def miss(self, source: Source) -> None:
        """Record that a host has to be queried."""
        peer = self._peers.get(source)
        if peer is not None and peer.filled == peer.gaps:
            peer.gaps += 1
            self._missing[source] = None

    def miss_later(self, source: Source, at_ns: int) -> None:
        """Record that a host has to be queried once this host's clock reads `at_ns`."""
        peer = self._peers.get(source)
        if peer is not None:
            peer.missed_at_ns = min(at_ns, peer.missed_at_ns or at_ns)
            self._missing[source] = None

    def restart(self, groups: set[str]) -> None:
        """Record that groups are received from now on: earlier messages were not lost."""
        for peer in self if groups else ():
            if peer.source.group in groups:
                peer.born = -1

    def end_reply(self, source: Source, gaps: int) -> None:
        """Record that a host has replied in full to a query sent after `gaps` gaps.

        With 0 gaps, the host was not reached (it may just have connected) and can be queried again.
        """
        peer = self._peers.get(source)
        if peer is not None:
            peer.filled = max(peer.filled, gaps)
            peer.queried_ns = None
