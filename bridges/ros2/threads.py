"""Threads on which actions run: a thread with a timer, a queue for another thread.

A transport's threads are daemon threads: a process that forgets to close a transport still ends.
But a daemon thread that is inside Zenoh when the interpreter ends aborts the process; releasing the
last reference to one of Zenoh's objects is enough. So threads that are about to end are joined
last.
"""

from __future__ import annotations

import atexit
import heapq
import itertools
import logging
import threading
import time
from collections import deque
from collections.abc import Callable
from queue import Empty, SimpleQueue
from threading import Thread
from weakref import WeakSet

_LOG = logging.getLogger("llfsm.bridges.ros2")

MOST_WAITING = 10_000
"""Actions that may wait in a :class:`CallQueue`."""
_MOST_AT_ONCE, _LEAST_AT_ONCE = 200, 20
_LONG_S = 0.05
_LIMIT_S = 5.0  # an action of a user's may block for ever

_ending: WeakSet[Thread] = WeakSet()  # a thread is in `threading`'s list until it has really ended


@atexit.register  # before any transport registers, and so after all are closed
def _join() -> None:
    until = time.monotonic() + _LIMIT_S
    for thread in list(_ending):
        thread.join(max(0.0, until - time.monotonic()))


def join_at_exit(thread: Thread) -> None:
    """Wait for a thread when the interpreter ends, after all transports are closed."""
    _ending.add(thread)


Put = Callable[[Callable[[], object]], None]
"""Queues an action for the thread that owns the state it changes."""


class CallQueue:
    """Hands actions from any thread to one thread, in the order of their arrival.

    The state that they change needs no lock, and changes only when its thread is ready. An error of
    an action is logged, and the next action runs. Whoever floods it does not keep the thread from
    its other work: each time it runs some, and of more than it may hold it drops the newest.
    """

    def __init__(self) -> None:
        self._waiting: deque[Callable[[], object]] = deque()
        self._dropped = 0

    def __len__(self) -> int:
        return len(self._waiting)

    def put(self, do: Callable[[], object]) -> None:
        """Queue an action for the next :meth:`run_pending`."""
        if len(self._waiting) < MOST_WAITING:
            self._waiting.append(do)
        else:
            self._dropped += 1

    def run_pending(self) -> None:
        """Run the actions queued so far, at most 200, or 20 if these take long; others wait."""
        if self._dropped:
            _LOG.warning("%d messages and requests were dropped: too many wait", self._dropped)
            self._dropped = 0
        until_s = time.monotonic() + _LONG_S
        for number in range(min(len(self._waiting), _MOST_AT_ONCE)):
            if number >= _LEAST_AT_ONCE and time.monotonic() > until_s:
                break
            try:
                self._waiting.popleft()()
            except Exception:
                _LOG.exception("a queued action failed")


class TimerThread:
    """Runs actions one after the other on a thread of its own, soon or after a delay.

    The middleware's own threads must not block. So futures get their results here, where callbacks
    that users attach may block. An action that fails is logged.
    """

    def __init__(self, name: str) -> None:
        self._todo: SimpleQueue[tuple[float, int, Callable[[], object] | None]] = SimpleQueue()
        self._count = itertools.count()  # so that actions are never compared
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def call_soon(self, do: Callable[[], object]) -> None:
        """Run ``do`` after the actions that were queued before."""
        self._todo.put((0.0, next(self._count), do))

    def call_later(self, seconds: float, do: Callable[[], object]) -> None:
        """Run ``do`` after ``seconds``, unless the thread is closed before."""
        self._todo.put((time.monotonic() + seconds, next(self._count), do))

    def close(self) -> None:
        """End the thread after the actions queued by :meth:`call_soon`."""
        join_at_exit(self._thread)  # they may hold objects of the middleware
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
