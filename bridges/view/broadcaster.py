"""Snapshots of what pages show, taken once for all pages."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Awaitable, Callable
from typing import Generic, TypeVar

__all__ = ["Broadcaster", "frames"]

T = TypeVar("T")

_log = logging.getLogger(__name__)

_PERIOD_S = 1 / 30
_SHARE = 5  # at most one part in so many of the time goes into snapshots and frames
_BEAT_S = 0.5  # between frames to an idle page, by which it notices a server that is gone


class Broadcaster(Generic[T]):
    """Call `take` for a snapshot each `period_s` seconds, while any page is open.

    When the last page is closed, `left` is called.
    """

    def __init__(
        self,
        take: Callable[[], T],
        *,
        period_s: float = _PERIOD_S,
        left: Callable[[], None] = lambda: None,
    ) -> None:
        self.snapshot: T | None = None
        self._take = take
        self._period_s = period_s
        self._left = left
        self._pages = 0
        self._serial = 0
        self._taken = asyncio.Event()
        self._task: asyncio.Task[None] | None = None

    async def __aenter__(self) -> Broadcaster[T]:
        """Add a page; the first one starts the snapshots."""
        self._pages += 1
        if self._task is None:
            self._task = asyncio.create_task(self._run())
        return self

    async def __aexit__(self, *_: object) -> None:
        self._pages -= 1
        if not self._pages and self._task is not None:
            self._task.cancel()
            self._task = None
            self._left()

    async def next(self, after: int) -> tuple[int, T]:
        """Wait for a snapshot newer than number `after`; return the newest and its number."""
        while self._serial <= after or self.snapshot is None:
            await self._taken.wait()
        return self._serial, self.snapshot

    async def _run(self) -> None:
        while True:
            # All the server's work is on this thread: its CPU time since the last snapshot is the
            # cost of the snapshot and of the frames made from it.
            began, cpu = time.monotonic(), time.thread_time()
            try:
                self.snapshot = self._take()
            except Exception:
                _log.exception("a snapshot has failed; the pages keep the last one")
            self._serial += 1
            self._taken.set()
            self._taken = asyncio.Event()
            await asyncio.sleep(self._period_s / 2)
            busy = time.thread_time() - cpu
            due = began + max(self._period_s, _SHARE * busy)
            await asyncio.sleep(max(0.0, due - time.monotonic()))


def frames(
    broadcaster: Broadcaster[T], encode: Callable[[T, bool], bytes | None]
) -> Callable[[], Awaitable[bytes]]:
    """Return what waits for the next frame of one page.

    `encode` makes it of a snapshot and whether a beat is due; without one, it returns None if
    nothing has changed.
    """
    serial, sent_s = 0, 0.0

    async def next_frame() -> bytes:
        nonlocal serial, sent_s
        frame = None
        while frame is None:
            serial, snapshot = await broadcaster.next(serial)
            frame = encode(snapshot, time.monotonic() - sent_s > _BEAT_S)
        sent_s = time.monotonic()
        return frame

    return next_frame
