"""A queue with a thread that empties it."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from typing import Generic, TypeVar

__all__ = ["Inbox"]

T = TypeVar("T")


class Inbox(Generic[T]):
    """Hands things over, one after the other, on a thread of its own.

    Beyond ``limit`` things that wait (None: no limit) the oldest is dropped.
    """

    def __init__(self, handle: Callable[[T], None], limit: int | None, name: str) -> None:
        self._handle = handle
        self._things: deque[T] = deque(maxlen=limit)
        self._changed = threading.Condition()
        self._closed = False
        threading.Thread(target=self._run, name=f"ros2 {name}", daemon=True).start()

    def put(self, thing: T) -> None:
        """Hand it over when those before it have been."""
        with self._changed:
            self._things.append(thing)
            self._changed.notify()

    def close(self) -> list[T]:
        """Hand over nothing more; return what still waited."""
        with self._changed:
            self._closed = True
            self._changed.notify()
            return list(self._things)

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._closed or self._things)
                if self._closed:
                    return
                thing = self._things.popleft()
            self._handle(thing)
