"""Receives from Zenoh on threads of ours.

Zenoh's own way of calling Python starts a thread that the interpreter waits for at its end: a
process that forgets to close a transport would never end. The interpreter does not wait for ours,
which are daemon threads; but a thread that is inside Zenoh when the interpreter ends aborts the
process, so threads that are ending are joined last.
"""

from __future__ import annotations

import atexit
import threading
from collections.abc import Callable
from functools import partial
from typing import TypeVar

import zenoh
import zenoh.handlers

from ..timer_thread import TimerThread

__all__ = ["hand_over", "receive"]

T = TypeVar("T")

_receiving: set[threading.Thread] = set()


@atexit.register  # before any transport registers, and so after all are closed
def _join() -> None:
    for thread in list(_receiving):
        thread.join(1.0)


def hand_over(do: Callable[[T], None], timer: TimerThread) -> zenoh.handlers.Callback[T]:
    """Return a handler that calls ``do`` on another thread, so that Zenoh does not wait for it."""

    def callback(thing: T) -> None:
        timer.call_soon(partial(do, thing))

    return zenoh.handlers.Callback(callback, indirect=False)


def receive(take: Callable[[], T], do: Callable[[T], None], name: str) -> None:
    """Call ``do`` with what ``take`` returns, on a new thread, until its channel is closed."""

    def run() -> None:
        while True:
            try:
                thing = take()
            except zenoh.ZError:
                _receiving.discard(thread)
                return  # its subscriber, its queryable or the session is closed
            do(thing)

    thread = threading.Thread(target=run, name=f"ros2 {name}", daemon=True)
    _receiving.add(thread)
    thread.start()
