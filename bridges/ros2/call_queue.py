"""Actions from a transport's threads, run on one other thread."""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import Any

from .errors import AlreadyAnsweredError
from .transport import ServiceRequest

__all__ = ["CallQueue", "Put", "through"]

_LOG = logging.getLogger("llfsm.bridges.ros2")

Put = Callable[[Callable[[], object]], None]
"""Queues an action for the thread that owns the state it changes."""


class CallQueue:
    """Hands actions from any thread to one thread, in the order of their arrival.

    The state that they change needs no lock, and changes only when its thread is ready. An error of
    an action is logged, and the next action runs.
    """

    def __init__(self) -> None:
        self._waiting: deque[Callable[[], object]] = deque()

    def __len__(self) -> int:
        return len(self._waiting)

    def put(self, do: Callable[[], object]) -> None:
        """Queue an action for the next :meth:`run_pending`."""
        self._waiting.append(do)

    def run_pending(self) -> None:
        """Run all actions queued so far; actions queued meanwhile wait for the next call."""
        for _ in range(len(self._waiting)):
            try:
                self._waiting.popleft()()
            except Exception:
                _LOG.exception("a queued action failed")


def through(
    put: Put, handle: Callable[[ServiceRequest[Any, Any]], None]
) -> Callable[[ServiceRequest[Any, Any]], None]:
    """Return a server's handler that queues requests for ``handle``; an error fails the request."""

    def work(request: ServiceRequest[Any, Any]) -> None:
        try:
            handle(request)
        except Exception as error:
            with suppress(AlreadyAnsweredError):
                request.fail(f"the server failed: {error}")
            raise

    return lambda request: put(partial(work, request))
