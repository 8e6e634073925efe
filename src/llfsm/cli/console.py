"""The process of a command: where it logs to, and how signals end it, also while it ends."""

from __future__ import annotations

import logging
import signal
import sys
import threading
from collections.abc import Callable
from types import FrameType

from llfsm.errors import printable


def log_to_console(level: int, *handlers: logging.Handler, is_on: bool = True) -> None:
    """Log messages from `level` on to `handlers`, by default to standard error, if that `is_on`."""
    used = handlers or (logging.StreamHandler(),)
    if not is_on:
        used = (logging.NullHandler(),)  # without a handler, Python would print warnings
    for each in used:
        each.setFormatter(_Printable())
    logging.basicConfig(level=level, handlers=used)


class _Printable(logging.Formatter):
    """Format a message alone, without characters that command a terminal."""

    def format(self, record: logging.LogRecord) -> str:
        """Format a record, its traceback included."""
        return printable(super().format(record))


def log_machines(*, is_on: bool) -> None:
    """Log messages of machines to standard output, warnings and errors to standard error."""
    messages, problems = logging.StreamHandler(sys.stdout), logging.StreamHandler(sys.stderr)
    messages.addFilter(lambda record: record.levelno < logging.WARNING)
    problems.setLevel(logging.WARNING)
    log_to_console(logging.INFO, messages, problems, is_on=is_on)


SIGNALS = ("SIGINT", "SIGTERM")
"""The causes of a stop that are a user's or a supervisor's request, by their names."""


def ending_once(
    do: Callable[[], object],
    is_ending: Callable[[], bool],
    may_interrupt: Callable[[], bool] = lambda: True,
) -> None:
    """Call `do`; let a second SIGINT cut its end short while it `may_interrupt`.

    A terminal and `ros2 launch` each send one for the same Ctrl-C, so the second must not change
    the exit status. `is_ending` is asked if the end has begun, or a signal has requested it. From
    then on SIGINT is ignored for the rest of the process, whose exit it would interrupt. In other
    threads than the main one, which cannot handle signals, `do` is called and nothing else done.
    """
    if threading.current_thread() is not threading.main_thread():
        do()
        return
    before = signal.getsignal(signal.SIGINT)

    def interrupt(_: int, __: FrameType | None) -> None:
        if is_ending():
            if not may_interrupt():
                return
            signal.signal(signal.SIGINT, signal.SIG_IGN)  # so there is one interrupt at most
        raise KeyboardInterrupt

    try:  # not a context manager, whose own code could be interrupted
        try:
            signal.signal(signal.SIGINT, interrupt)
            do()
        finally:
            signal.signal(signal.SIGINT, signal.SIG_IGN if is_ending() else before)
    except KeyboardInterrupt:
        if not is_ending():
            raise


def stop_for_good(stop: Callable[[], object]) -> None:
    """Call `stop` at each SIGINT and SIGTERM from now on: a second one changes nothing."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop())


def ignore_interrupts() -> None:
    """Let no further SIGINT interrupt the exit of the process, whose end has been asked for."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
