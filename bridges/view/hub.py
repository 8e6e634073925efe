"""The one look at the source that all pages share."""

from __future__ import annotations

import asyncio
import logging
import time

from .source import Look, Source

__all__ = ["Hub"]

_log = logging.getLogger(__name__)

_PERIOD_S = 1 / 30
_SHARE = 5  # of the time, one part in so many is the most that looking and telling may take


class Hub:
    """Look at a source while any page is open, up to thirty times a second."""

    def __init__(self, source: Source) -> None:
        self.source = source
        self.look: Look | None = None
        self._pages = 0
        self._serial = 0
        self._looked = asyncio.Event()
        self._task: asyncio.Task[None] | None = None

    async def __aenter__(self) -> Hub:
        """Have one page more; looking begins with the first."""
        self._pages += 1
        if self._task is None:
            self._task = asyncio.create_task(self._run())
        return self

    async def __aexit__(self, *_: object) -> None:
        self._pages -= 1
        if not self._pages and self._task is not None:
            self._task.cancel()
            self._task = None

    async def next(self, after: int) -> tuple[int, Look]:
        """Return the newest look with its number, once there is one after number `after`."""
        while self._serial <= after or self.look is None:
            await self._looked.wait()
        return self._serial, self.look

    async def _run(self) -> None:
        while True:
            # All the server's work is on this thread: what it took since the last look is what
            # looking and telling the pages of it costs.
            began, cpu = time.monotonic(), time.thread_time()
            try:
                self.look = self.source.look()
            except Exception:
                _log.exception("this look has failed; the pages keep the last one")
            self._serial += 1
            self._looked.set()
            self._looked = asyncio.Event()
            await asyncio.sleep(_PERIOD_S / 2)
            busy = time.thread_time() - cpu
            due = began + max(_PERIOD_S, _SHARE * busy)
            await asyncio.sleep(max(0.0, due - time.monotonic()))
