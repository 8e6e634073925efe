"""Waits for a transport's threads when the interpreter ends.

They are daemon threads: a process that forgets to close a transport still ends. But a daemon thread
that is inside Zenoh when the interpreter ends aborts the process; releasing the last reference to
one of Zenoh's objects is enough. So threads that are about to end are joined last.
"""

from __future__ import annotations

import atexit
import time
from threading import Thread
from weakref import WeakSet

__all__ = ["join_at_exit"]

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
