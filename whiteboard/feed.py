"""What is added to a slot, one message after the other, for those who want to be told of it.

A slot keeps only its latest message and its writers never wait. So nobody can be told of every
message: who looks too late misses some, and the counts tell how many.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from typing import Generic

from .board import BoundSlot, Sample
from .errors import BoardClosedError, MessageUnreadableError
from .message import M

__all__ = ["Backlog", "Feed"]

_LOOK_S = 0.05  # how long a close may take, as long as a wait in shared memory sleeps at most


class Feed(Generic[M]):
    """Observe a slot: wait for its messages, and count those that were replaced unseen.

    Begin with the first one newer than number ``after``; if that is None with the latest that is
    there already, and then none before it counts as missed.
    """

    def __init__(self, slot: BoundSlot[M], after: int | None) -> None:
        if after is not None and after < 0:
            raise ValueError(f"after={after}: the count of a message is needed, 0 or more")
        self._slot = slot
        self._last = max(slot.count - 1, 0) if after is None else after
        self.missed = 0

    def next(self) -> Sample[M] | None:
        """Wait for a newer message and return the latest; None if none came for a while.

        Raise :class:`.MessageUnreadableError`, once for each such message, or what ends the feed,
        :class:`.BoardClosedError` among it.
        """
        try:
            sample = self._slot.wait(after=self._last, timeout=_LOOK_S)
        except MessageUnreadableError as error:
            self._advance(error.count)
            self.missed += 1
            raise
        if sample is not None:
            self._advance(sample.count)
        return sample

    def _advance(self, count: int) -> None:
        self.missed += count - self._last - 1
        self._last = count


class Backlog(Generic[M]):
    """Observe a slot in a thread, and keep up to ``size`` messages until they are taken.

    When it is full the oldest one makes room, and is missed. ``wake`` is called in that thread
    when there is something to take again, and at the end.
    """

    def __init__(
        self, feed: Feed[M], size: int, wake: Callable[[Backlog[M]], object] = lambda _: None
    ) -> None:
        if size < 1:
            raise ValueError(f"backlog={size}: at least the newest message has to wait")
        self._feed = feed
        self._size = size
        self._wake = wake
        self._kept: deque[Sample[M] | Exception] = deque()
        self._dropped = 0
        self._changed = threading.Condition()
        self._over = False
        self.ended = False
        self._thread = threading.Thread(target=self._collect, name="backlog", daemon=True)
        self._thread.start()

    @property
    def missed(self) -> int:
        """Messages that were never, and will never be, taken."""
        return self._feed.missed + self._dropped

    def take(self) -> Sample[M] | None:
        """Return the oldest message, None if there is none now; raise as :meth:`Feed.next`."""
        with self._changed:
            if not self._kept:
                if self.ended:
                    raise BoardClosedError("this backlog has ended")
                return None
            item = self._kept.popleft()
        if isinstance(item, Exception):
            raise item
        return item

    def next(self) -> Sample[M] | None:
        """Wait for a message and return the oldest, as :meth:`Feed.next` returns the latest."""
        with self._changed:
            self._changed.wait_for(lambda: self._kept or self.ended, _LOOK_S)
        return self.take()

    def stop(self) -> None:
        """Ask the thread to end, soon, and forget what was not taken."""
        with self._changed:
            self._over = True
            self._kept.clear()

    def join(self) -> None:
        """Wait until the thread has ended."""
        self._thread.join()

    def _collect(self) -> None:
        while not self._over:
            try:
                sample = self._feed.next()
                if sample is not None:
                    self._put(sample)
            except MessageUnreadableError as error:
                self._put(error)
            except BoardClosedError:
                break
            except Exception as error:
                self._put(error)
                break
        with self._changed:
            self.ended = True
            self._changed.notify_all()
        self._wake(self)

    def _put(self, item: Sample[M] | Exception) -> None:
        with self._changed:
            if self._over:
                return
            first = not self._kept
            if len(self._kept) == self._size:
                self._dropped += isinstance(self._kept.popleft(), Sample)
            self._kept.append(item)
            self._changed.notify_all()
        if first:  # else who takes has been told, and has not taken all yet
            self._wake(self)
