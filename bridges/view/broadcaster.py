"""Snapshots of the source, taken once for all pages."""

from __future__ import annotations

import asyncio
import logging
import time

from .page_source import PageSource, Snapshot

__all__ = ["Broadcaster"]

_log = logging.getLogger(__name__)

_PERIOD_S = 1 / 30
_SHARE = 5  # at most one part in so many of the time goes into snapshots and frames


class Broadcaster:
    """Take a snapshot up to thirty times a second, while any page is open."""

    def __init__(self, source: PageSource) -> None:
        self.source = source
        self.snapshot: Snapshot | None = None
        self._pages = 0
        self._serial = 0
        self._taken = asyncio.Event()
        self._task: asyncio.Task[None] | None = None

    async def __aenter__(self) -> Broadcaster:
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

    async def next(self, after: int) -> tuple[int, Snapshot]:
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
                self.snapshot = self.source.snapshot()
            except Exception:
                _log.exception("a snapshot has failed; the pages keep the last one")
            self._serial += 1
            self._taken.set()
            self._taken = asyncio.Event()
            await asyncio.sleep(_PERIOD_S / 2)
            busy = time.thread_time() - cpu
            due = began + max(_PERIOD_S, _SHARE * busy)
            await asyncio.sleep(max(0.0, due - time.monotonic()))
