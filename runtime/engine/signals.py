"""Stop cleanly at SIGINT and SIGTERM."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from queue import Empty, SimpleQueue
from types import FrameType

__all__ = ["Critical", "StopRequest", "stop_on_signals"]

_SIGNALS = (signal.SIGINT, signal.SIGTERM)
_LOOK_S = 0.2


class StopRequest:
    """Whether a stop was asked for: an event that one thread waits for, and a handler may set.

    A `threading.Event` will not do: a handler runs in the thread that it interrupts, and where that
    thread holds the event's lock, on its way into a wait, `set` would wait for it for ever.
    """

    def __init__(self) -> None:
        self._made = False
        self._bell: SimpleQueue[None] = SimpleQueue()  # `put` may interrupt a `get` or `put`

    def make(self) -> None:
        """Ask for a stop; from any thread, and from a signal's handler."""
        self._made = True
        self._bell.put(None)

    def is_made(self) -> bool:
        """Return whether a stop was asked for."""
        return self._made

    def wait(self, timeout_s: float | None = None) -> bool:
        """Wait until a stop is asked for, at most so long; return whether it was.

        A signal need not end a wait of the main thread, where handlers run: it may come after the
        last look for one, or to a thread of a library. So a wait looks for one now and then.
        """
        end_s = None if timeout_s is None else time.monotonic() + timeout_s
        while not self._made:
            left_s = _LOOK_S if end_s is None else min(end_s - time.monotonic(), _LOOK_S)
            with suppress(Empty):
                self._bell.get(timeout=max(left_s, 0))
            if left_s < _LOOK_S:
                break
        return self._made


class Critical:
    """A `with` block of it is what no second signal may interrupt; blocks may be nested."""

    def __init__(self) -> None:
        self.depth = 0

    def __enter__(self) -> None:
        self.depth += 1

    def __exit__(self, *_: object) -> None:
        self.depth -= 1


@contextmanager
def stop_on_signals(
    stop: Callable[[str], None], critical: Critical | None = None
) -> Iterator[None]:
    """Call `stop` with the signal's name at the first SIGINT or SIGTERM.

    The second one comes to the handlers that were there, so that a second Ctrl-C interrupts; inside
    a block of `critical`, and until `stop` has returned, it is ignored. They come back at the end,
    too. Only the main thread can handle signals: elsewhere nothing is done.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.getsignal(number) for number in _SIGNALS}
    asked = has_stopped = False

    def restore() -> None:
        for number, handler in before.items():
            if signal.getsignal(number) is on_signal:
                signal.signal(number, signal.SIG_DFL if handler is None else handler)

    def on_signal(number: int, _: FrameType | None) -> None:
        nonlocal asked, has_stopped
        if not asked:
            asked = True
            stop(signal.Signals(number).name)
            has_stopped = True
        elif has_stopped and (critical is None or not critical.depth):
            restore()
            signal.raise_signal(number)

    for number in _SIGNALS:
        signal.signal(number, on_signal)
    try:
        yield
    finally:
        restore()
