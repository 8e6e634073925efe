"""A stop that a signal's handler asks for, whatever the thread that it interrupts is doing."""

from __future__ import annotations

import gc
import os
import signal
import sys
import threading
from collections.abc import Iterator
from functools import partial
from types import FrameType
from typing import Any

import pytest

from llfsm.runtime.engine.realtime import StopRequest, stop_on_signals


@pytest.fixture(autouse=True)
def _untraced() -> Iterator[None]:
    """Let no finalizer of somebody else's garbage run lines that are counted."""
    gc.disable()
    yield
    gc.enable()
    sys.settrace(None)


def test_it_is_made_once_and_stays() -> None:
    asked = StopRequest()
    assert not asked.is_made()
    assert not asked.wait(0)
    asked.make()
    asked.make()
    assert asked.is_made()
    assert asked.wait()
    assert asked.wait(0)


def test_another_thread_ends_the_wait() -> None:
    asked = StopRequest()
    threading.Timer(0.01, asked.make).start()
    assert asked.wait()


def test_a_signal_ends_the_wait() -> None:
    asked = StopRequest()
    with stop_on_signals(lambda _: asked.make()):
        threading.Timer(0.01, os.kill, (os.getpid(), signal.SIGTERM)).start()
        assert asked.wait()


def test_a_signal_ends_the_wait_that_it_does_not_interrupt() -> None:
    """The system may give it to any thread, but handlers run in the main one."""
    asked = StopRequest()
    over = threading.Event()
    with stop_on_signals(lambda _: asked.make()):
        other = threading.Thread(target=over.wait)
        other.start()
        assert other.ident is not None
        threading.Timer(0.01, signal.pthread_kill, (other.ident, signal.SIGTERM)).start()
        assert asked.wait()
        over.set()
        other.join()


def test_signals_that_come_at_once_are_one() -> None:
    """`ros2 launch` and a terminal each send one for the same Ctrl-C."""
    signals = []

    def stop(name: str) -> None:
        signal.raise_signal(signal.SIGINT)  # before anything knows of the first one
        signals.append(name)

    with stop_on_signals(stop):
        signal.raise_signal(signal.SIGINT)
        assert signals == ["SIGINT"]
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)


def lines_of(call: Any) -> int:
    """Return how many lines of Python a call runs."""
    number = 0

    def trace(frame: FrameType, event: str, _: object) -> Any:
        nonlocal number
        number += event == "line"
        return trace

    sys.settrace(trace)
    call()
    sys.settrace(None)
    return number


def wait_interrupted(asked: StopRequest, line: int) -> None:
    """Wait, and make the request before that line is run, as a handler would."""
    left = line

    def trace(frame: FrameType, event: str, _: object) -> Any:
        nonlocal left
        left -= event == "line"
        if left == 0 and event == "line":
            sys.settrace(None)
            asked.make()
        return trace

    sys.settrace(trace)
    asked.wait(0)
    sys.settrace(None)


def test_a_signal_may_come_at_every_line_of_the_wait() -> None:
    """An Event fails this: at some lines its lock is held, and the handler waits for it."""
    lines = lines_of(partial(StopRequest().wait, 0))
    assert lines > 2
    for line in range(1, lines + 1):
        asked = StopRequest()
        wait_interrupted(asked, line)
        assert asked.is_made()
        assert asked.wait(0)
