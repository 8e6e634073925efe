"""Each new message of a slot: to a callback in a thread, or to an ``async for``.

A slot keeps only its latest message and its writers never wait. So no reader is guaranteed every
message: a reader that reads too late misses some, and the counts show how many.

Both ways follow the slot by a `Cursor`, which waits for a count newer than its own and accounts for
those in between. A `Backlog` is a thread that does so all the time and keeps some messages for a
reader that is slower for a while: bounded, and the oldest go first. Every error is either about one
message (it cannot be decoded), after which reading goes on, or the end.
"""

from __future__ import annotations

import asyncio
import logging
import threading
import weakref
from collections import deque
from collections.abc import Callable
from typing import Generic, Protocol, Self

from llfsm.whiteboard.closing import ClosedOnExit
from llfsm.whiteboard.errors import BoardClosedError, MessageUnreadableError
from llfsm.whiteboard.message import M
from llfsm.whiteboard.slots import Sample

_log = logging.getLogger(__name__)

POLL_S = 0.05
"""Seconds after which a wait looks whether it is to end, and so the most that a close takes."""


class Waitable(Protocol[M]):
    """The part of a bound slot that a cursor needs.

    A protocol, because bound slots import this module to offer subscriptions.
    """

    @property
    def count(self) -> int:
        """The number of messages added so far."""

    def wait(self, *, after: int, timeout: float | None = None) -> Sample[M] | None:
        """Block until there is a message newer than number ``after``, and return the latest."""


class Cursor(Generic[M]):
    """A reader's position in a slot; it counts the messages that were replaced before it read them.

    It begins with the first message newer than number ``after``. With None it begins with the
    latest existing message, and earlier ones do not count as missed.
    """

    def __init__(self, slot: Waitable[M], after: int | None) -> None:
        if after is not None and after < 0:
            raise ValueError(f"after={after} must be the count of a message, 0 or more")
        self._slot = slot
        self._last = max(slot.count - 1, 0) if after is None else after
        self._finishing = False
        self._ended = False
        self.missed = 0

    def next(self, timeout: float = POLL_S) -> Sample[M] | None:
        """Wait for a newer message and return the latest; return None after ``timeout`` seconds.

        Raise :class:`.MessageUnreadableError` once for each message that cannot be decoded,
        :class:`.BoardClosedError` at the end, and any error that makes the slot unusable.
        """
        if self._ended:
            raise BoardClosedError("this cursor has ended")
        self._ended = self._finishing
        try:
            sample = self._slot.wait(after=self._last, timeout=0.0 if self._ended else timeout)
        except MessageUnreadableError as error:
            self._advance(error.count)
            self.missed += 1
            raise
        if sample is not None:
            self._advance(sample.count)
        return sample

    def finish(self) -> None:
        """End after one more :meth:`next`, which does not wait."""
        self._finishing = True

    def _advance(self, count: int) -> None:
        self.missed += count - self._last - 1
        self._last = count


class Backlog(Generic[M]):
    """Follows a slot in a thread, and keeps up to ``size`` messages until they are taken.

    When it is full, a new message replaces the oldest, which counts as missed. The thread calls
    ``wake`` when the backlog is no longer empty, and at the end.
    """

    def __init__(
        self, cursor: Cursor[M], size: int, wake: Callable[[Backlog[M]], object] = lambda _: None
    ) -> None:
        if size < 1:
            raise ValueError(f"backlog={size} must be at least 1")
        self._cursor = cursor
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
        """The number of messages that :meth:`take` has not returned, and will not return."""
        return self._cursor.missed + self._dropped

    def take(self) -> Sample[M] | None:
        """Return the oldest message, or None if it is empty; raise as :meth:`Cursor.next` does."""
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
        """Wait for a message and return the oldest; see :meth:`Cursor.next`."""
        with self._changed:
            self._changed.wait_for(lambda: self._kept or self.ended, POLL_S)
        return self.take()

    def finish(self) -> None:
        """Collect only the messages added by now; it ends when they have been taken."""
        self._cursor.finish()

    def stop(self) -> None:
        """Discard the messages that were not taken, and have the thread end soon."""
        with self._changed:
            self._over = True
            self._kept.clear()

    def join(self) -> None:
        """Wait until the thread has ended."""
        self._thread.join()

    def _collect(self) -> None:
        while not self._over:
            try:
                sample = self._cursor.next()
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
        if first:  # else the reader was woken before, and has not taken everything yet
            self._wake(self)


class Subscription(ClosedOnExit, Generic[M]):
    """Calls a function in a thread of its own, until closed; see :meth:`.BoundSlot.subscribe`."""

    def __init__(
        self,
        slot: Waitable[M],
        callback: Callable[[Sample[M]], object],
        *,
        after: int | None,
        backlog: int,
        on_error: Callable[[Exception], object] | None,
    ) -> None:
        self._slot = slot
        self._callback = callback
        self._on_error = on_error
        self._over = False
        self._finishing = False
        cursor = Cursor(slot, after)
        # The slot itself is a backlog of one.
        self._source = cursor if backlog == 1 else Backlog(cursor, backlog)
        self._thread = threading.Thread(target=self._run, name=f"{self}", daemon=True)
        self._thread.start()

    def __repr__(self) -> str:
        return f"subscription of {getattr(self._callback, '__qualname__', self._callback)}"

    @property
    def missed(self) -> int:
        """The number of messages that the callback did not, and will not, receive."""
        return self._source.missed

    @property
    def active(self) -> bool:
        """False once the subscription is closed, or has ended with its board."""
        return not self._over and self._thread.is_alive()

    def finish(self) -> None:
        """Deliver the messages added by now, and then end; return at once.

        To end several subscriptions, finish all of them, and then :meth:`close` each, which waits
        for its end.
        """
        self._finishing = True
        self._source.finish()

    def close(self) -> None:
        """End the subscription; closing twice is fine.

        When this returns, the callback is not running and will not be called again. The callback
        itself may call this; then its current call is the last one. It waits for a running
        callback, so do not hold a lock that the callback acquires. Messages in the backlog are not
        delivered, unless :meth:`finish` was called before.
        """
        within = threading.current_thread() is self._thread
        if within or not self._finishing:
            self._over = True
        if not within:
            self._thread.join()

    def _run(self) -> None:
        try:
            while not self._over:
                try:
                    sample = self._source.next()
                except MessageUnreadableError as error:
                    self._report(error)
                    continue
                if sample is not None and not self._over:
                    self._call(sample)
        except BoardClosedError:
            pass
        except Exception as error:
            self._report(error)
        finally:
            if isinstance(self._source, Backlog):
                self._source.stop()
                self._source.join()

    def _call(self, sample: Sample[M]) -> None:
        try:
            self._callback(sample)
        except Exception as error:
            # The board was closed while the callback used it: the end, not an error.
            if not (isinstance(error, BoardClosedError) and self._is_board_closed()):
                self._report(error)

    def _is_board_closed(self) -> bool:
        try:
            self._slot.count  # noqa: B018  for the error that it raises
        except BoardClosedError:
            return True
        return False

    def _report(self, error: Exception) -> None:
        """Pass an error to ``on_error``, and log it unless that returns True."""
        handled: object = False
        if self._on_error is not None:
            try:
                handled = self._on_error(error)
            except Exception:
                _log.exception("%s: on_error failed, too", self)
        if handled is not True:
            _log.error("%s: %s: %s", self, type(error).__name__, error, exc_info=error)


class Stream(Generic[M]):
    """Iterates over a slot's samples in the running event loop; see :meth:`.BoundSlot.stream`.

    A thread waits for messages, and wakes the loop only if all earlier ones were taken. It ends
    with the stream: at :meth:`aclose`, when there is no reference to the stream any more, with
    the board, or with the loop.
    """

    def __init__(self, slot: Waitable[M], *, after: int | None, backlog: int) -> None:
        loop = asyncio.get_running_loop()
        arrived = self._arrived = asyncio.Event()

        # The thread refers to this function, which therefore must not refer to the stream.
        def wake(kept: Backlog[M]) -> None:
            try:
                loop.call_soon_threadsafe(arrived.set)
            except RuntimeError:  # the loop was closed
                kept.stop()

        self._backlog = Backlog(Cursor(slot, after), backlog, wake)
        weakref.finalize(self, self._backlog.stop)

    @property
    def missed(self) -> int:
        """The number of messages that the iteration did not, and will not, return."""
        return self._backlog.missed

    def __aiter__(self) -> Self:
        return self

    async def __anext__(self) -> Sample[M]:
        """Wait for a sample. If the wait is cancelled, no sample is lost.

        Raise :class:`.MessageUnreadableError` for a message that cannot be decoded; the iteration
        may continue.
        """
        try:
            while (sample := self._backlog.take()) is None:
                self._arrived.clear()  # not too late: a wake-up is a call in this loop
                await self._arrived.wait()
        except BoardClosedError:
            raise StopAsyncIteration from None
        return sample

    async def aclose(self) -> None:
        """End the iteration and its thread; closing twice is fine."""
        self._backlog.stop()
        while not self._backlog.ended:
            self._arrived.clear()
            await self._arrived.wait()

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.aclose()
