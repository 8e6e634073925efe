"""Receives from Zenoh on threads of ours.

Zenoh's own way of calling Python starts a thread that the interpreter waits for at its end: a
process that forgets to close a transport would never end.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from functools import partial
from typing import TypeVar

import zenoh
import zenoh.handlers

from ..threads import join_at_exit
from ..timer_thread import TimerThread

__all__ = ["hand_over", "receive"]

T = TypeVar("T")


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
                return  # its subscriber, its queryable or the session is closed
            do(thing)

    thread = threading.Thread(target=run, name=f"ros2 {name}", daemon=True)
    thread.start()
    join_at_exit(thread)
