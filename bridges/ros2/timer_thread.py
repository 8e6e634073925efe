"""The thread on which a transport does what must not be done where it is found out."""

from __future__ import annotations

import heapq
import itertools
import logging
import threading
import time
from collections.abc import Callable
from queue import Empty, SimpleQueue

__all__ = ["TimerThread"]

_LOG = logging.getLogger("llfsm.bridges.ros2")


class TimerThread:
    """Runs actions one after the other on a thread of its own.

    Middleware calls back on threads where nothing may wait; a future's result is given here, so
    that what users attach to it may take its time. An action that fails is logged.
    """

    def __init__(self, name: str) -> None:
        self._todo: SimpleQueue[tuple[float, int, Callable[[], object] | None]] = SimpleQueue()
        self._count = itertools.count()  # so that actions are never compared
        threading.Thread(target=self._run, name=name, daemon=True).start()

    def call_soon(self, do: Callable[[], object]) -> None:
        """Run ``do`` after what was asked for before."""
        self._todo.put((0.0, next(self._count), do))

    def call_later(self, seconds: float, do: Callable[[], object]) -> None:
        """Run ``do`` when ``seconds`` have passed, unless it is closed before."""
        self._todo.put((time.monotonic() + seconds, next(self._count), do))

    def close(self) -> None:
        """End the thread when it has done what was to be done soon."""
        self._todo.put((0.0, next(self._count), None))

    def _run(self) -> None:
        waiting: list[tuple[float, int, Callable[[], object] | None]] = []
        while True:
            try:
                timeout = max(0.0, waiting[0][0] - time.monotonic()) if waiting else None
                item = self._todo.get(timeout=timeout)
            except Empty:
                item = heapq.heappop(waiting)
            else:
                if item[0]:
                    heapq.heappush(waiting, item)
                    continue
            if (do := item[2]) is None:
                return
            try:
                do()
            except Exception:
                _LOG.exception("an action of a transport failed")
