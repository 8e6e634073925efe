"""What came in on a transport's threads and is to be done on another."""

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
"""What takes something to be done on the one thread where a state lives."""


class CallQueue:
    """Brings things from any thread to one, in the order in which they came.

    So that what they change needs no lock, and changes only when that thread is ready for it. An
    action that raises something is logged, and the next one is done.
    """

    def __init__(self) -> None:
        self._waiting: deque[Callable[[], object]] = deque()

    def __len__(self) -> int:
        return len(self._waiting)

    def put(self, do: Callable[[], object]) -> None:
        """Have it done when the backlog is worked off next."""
        self._waiting.append(do)

    def run_pending(self) -> None:
        """Do all that waits now; what comes meanwhile has to wait for the next time."""
        for _ in range(len(self._waiting)):
            try:
                self._waiting.popleft()()
            except Exception:
                _LOG.exception("something that came in could not be done")


def through(
    put: Put, handle: Callable[[ServiceRequest[Any, Any]], None]
) -> Callable[[ServiceRequest[Any, Any]], None]:
    """Return a server's handler that has requests handled there; what raises fails the request."""

    def work(request: ServiceRequest[Any, Any]) -> None:
        try:
            handle(request)
        except Exception as error:
            with suppress(AlreadyAnsweredError):
                request.fail(f"the server failed: {error}")
            raise

    return lambda request: put(partial(work, request))
