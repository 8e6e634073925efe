"""The other hosts of a board: which are there, and which have messages that are missing here."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from ..messages.llfsm import PeerStatus
from .batches import Heartbeat, ReceivedBatch

__all__ = ["Peer", "Peers", "Source"]

_RETRY_NS = 500_000_000  # a host that does not reply is queried again after this time
_FORGET_NS = 60_000_000_000  # a host that sends nothing is forgotten after this time
_MAX_PEERS = 100  # of one certificate; further ones are not tracked, which bounds the memory


class Source(NamedTuple):
    """Who has sent a message."""

    name: str
    """In its certificate; empty if it is not known."""
    host: int
    """The id that it claims."""

    def __str__(self) -> str:
        return self.name or f"{self.host:016x}"


class Peer:
    """What is known of another host."""

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
        self.missed_at_ns: int | None = None  # by this host's clock: something is missing then

    def receive(self, message: ReceivedBatch | Heartbeat, now_ns: int, wall_ns: int) -> None:
        """Record a message; messages arrive in the order in which they were sent.

        A host that restarts is told by another `born`, not by a later one: its clock may have been
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

    def status(self, now_ns: int) -> PeerStatus:
        """Return its status."""
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
    """The other hosts, by who they are."""

    def __init__(self) -> None:
        self._peers: dict[Source, Peer] = {}

    def __iter__(self) -> Iterator[Peer]:
        return iter(list(self._peers.values()))

    def receive(
        self, source: Source, message: ReceivedBatch | Heartbeat, now_ns: int, wall_ns: int
    ) -> bool:
        """Record a message; return whether its sender is new or has restarted."""
        peer = self._peers.get(source)
        if peer is None:
            if sum(known.name == source.name for known in self._peers) >= _MAX_PEERS:
                return False
            peer = self._peers[source] = Peer(source)
        is_new = peer.born != message.born
        peer.receive(message, now_ns, wall_ns)
        return is_new

    def to_query(self, now_ns: int, wall_ns: int) -> list[Peer]:
        """Return the hosts to query now: those with a gap and no recent query."""
        found = []
        for peer in self:
            if peer.missed_at_ns is not None and peer.missed_at_ns <= wall_ns:
                peer.missed_at_ns = None
                peer.gaps += 1
            if now_ns - peer.received_ns > _FORGET_NS:
                del self._peers[peer.source]
            elif peer.filled != peer.gaps and (
                peer.queried_ns is None or now_ns - peer.queried_ns >= _RETRY_NS
            ):
                peer.queried_ns = now_ns
                found.append(peer)
        return found

    def miss(self, source: Source) -> None:
        """Record that a host has to be queried."""
        peer = self._peers.get(source)
        if peer is not None and peer.filled == peer.gaps:
            peer.gaps += 1

    def miss_later(self, source: Source, at_ns: int) -> None:
        """Record that a host has to be queried when this host's clock reads `at_ns`."""
        peer = self._peers.get(source)
        if peer is not None:
            peer.missed_at_ns = min(at_ns, peer.missed_at_ns or at_ns)

    def end_reply(self, source: Source, gaps: int) -> None:
        """Record that a host has replied in full to a query sent after `gaps` gaps.

        With 0 gaps, the host was not reached (it may just have connected) and can be queried again.
        """
        peer = self._peers.get(source)
        if peer is not None:
            peer.filled = max(peer.filled, gaps)
            peer.queried_ns = None
