"""Recognises the messages that a relay of both directions has sent itself."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Generic

from llfsm.whiteboard import BoundSlot
from llfsm.whiteboard.message import M

from ..transport import Publisher, SerializedMessage
from ..types import RosMessage

__all__ = ["EchoFilter"]

_RETURN_S = 1.0  # within which a published message comes back, if at all
_MOST = 1000


class EchoFilter(Generic[M]):
    """Remembers what one relay has sent in each direction.

    On the board a message is identified by its count in the slot, in ROS by its publisher: an equal
    message from another publisher is a new one. Where a transport does not report publishers, the
    messages themselves are compared: each one published cancels one that arrives within a second.
    """

    def __init__(
        self,
        publisher: Publisher[M],
        of: RosMessage[M],
        now: Callable[[], float] = time.monotonic,
    ) -> None:
        self._gid = publisher.gid
        self._encode = of.encode
        self._now = now
        self._lock = threading.Lock()
        self._added = 0
        self._published: deque[tuple[float, bytes]] = deque(maxlen=_MOST)

    def add(self, slot: BoundSlot[M], message: M) -> int:
        """Add a message from ROS to the slot, and return its count."""
        with self._lock:  # else it is relayed before its count is known
            self._added = slot.add(message)
            return self._added

    def is_news(self, count: int) -> bool:
        """Return whether ROS does not have the message of this count, nor a newer one."""
        with self._lock:
            return count > self._added

    def publishing(self, message: M) -> None:
        """Remember a message that is about to be published."""
        if not self._gid:
            with self._lock:
                self._published.append((self._now(), self._encode(message)))

    def is_ours(self, arrival: SerializedMessage[M]) -> bool:
        """Return whether a received message was published here.

        Raise :class:`.CdrError` if it has to be decoded and cannot be.
        """
        if self._gid:
            return arrival.info.gid == self._gid
        if not self._published:
            return False
        data = self._encode(arrival.decode())  # not what arrived: encoders pad differently
        oldest = self._now() - _RETURN_S
        with self._lock:
            while self._published and self._published[0][0] < oldest:
                self._published.popleft()
            for entry in self._published:
                if entry[1] == data:
                    self._published.remove(entry)
                    return True
        return False
