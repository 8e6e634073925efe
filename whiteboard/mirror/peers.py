"""The other hosts of a board: who is there, and from whom something is missing."""

from __future__ import annotations

from collections.abc import Iterator

from ..messages.llfsm import PeerStatus
from .wire import Batch, Beat

__all__ = ["Peer", "Peers"]

_AGAIN_NS = 500_000_000  # after so long without an answer a host is asked again
_GONE_NS = 60_000_000_000  # after so long without a sign of life a host is forgotten
_MOST = 1000  # hosts; further ones are not tracked, so that nobody can fill the memory


class Peer:
    """Another host, as of what arrived from it."""

    def __init__(self, sender: int) -> None:
        self.sender = sender
        self.name = ""
        self.born = -1
        self.number = 0  # of its latest batch
        self.heard_ns = 0
        self.lag_ns = 0
        self.received = 0
        self.lost = 0
        self.gaps = 0  # how often something was missing
        self.filled = 0  # the gaps that its answers have filled
        self.asked_ns: int | None = None

    def hear(self, message: Batch | Beat, now_ns: int, wall_ns: int) -> None:
        """Take note of a message, in the order of its being sent."""
        self.heard_ns = now_ns
        batch = isinstance(message, Batch)
        if message.born < self.born:  # of its life before
            return
        if message.born != self.born:
            self.born, self.number = message.born, message.number
            self.gaps += 1  # what it had before we knew it
        else:
            missing = message.number - self.number - batch
            if missing > 0:
                self.lost += missing
                self.gaps += 1
            self.number = max(self.number, message.number)
        if batch:
            self.received += 1
            self.lag_ns = wall_ns - message.sent_ns
        else:
            self.name = getattr(message, "name", "")

    def status(self, now_ns: int) -> PeerStatus:
        """Describe it."""
        return PeerStatus(
            name=self.name,
            host=f"{self.sender:016x}",
            silent_s=round((now_ns - self.heard_ns) / 1e9, 3),
            lag_ms=round(self.lag_ns / 1e6, 3),
            received=self.received,
            lost=self.lost,
        )


class Peers:
    """All of them, by id."""

    def __init__(self) -> None:
        self._peers: dict[int, Peer] = {}

    def __iter__(self) -> Iterator[Peer]:
        return iter(list(self._peers.values()))

    def hear(self, message: Batch | Beat, now_ns: int, wall_ns: int) -> bool:
        """Take note of a message; True if its sender is new."""
        peer = self._peers.get(message.sender)
        if peer is None:
            if len(self._peers) >= _MOST:
                return False
            peer = self._peers[message.sender] = Peer(message.sender)
        is_new = peer.born < message.born
        peer.hear(message, now_ns, wall_ns)
        return is_new

    def to_ask(self, now_ns: int) -> list[Peer]:
        """Return those from whom something is missing and who were not asked just now; ask them."""
        found = []
        for peer in self:
            if now_ns - peer.heard_ns > _GONE_NS:
                del self._peers[peer.sender]
            elif peer.filled != peer.gaps and (
                peer.asked_ns is None or now_ns - peer.asked_ns >= _AGAIN_NS
            ):
                peer.asked_ns = now_ns
                found.append(peer)
        return found

    def miss(self, sender: int) -> None:
        """Take note that something is to be asked of a host."""
        peer = self._peers.get(sender)
        if peer is not None and peer.filled == peer.gaps:
            peer.gaps += 1

    def answered(self, sender: int, gaps: int) -> None:
        """Take note that a host has answered in full what it was asked after so many gaps.

        After none, it was not reached (it was just connected, say), and can be asked again.
        """
        peer = self._peers.get(sender)
        if peer is not None:
            peer.filled = max(peer.filled, gaps)
            peer.asked_ns = None
