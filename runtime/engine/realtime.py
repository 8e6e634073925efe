"""Rounds in real time, as far as Linux can: a fixed priority, locked memory, a core, no garbage.

Each is a right that an administrator gives. What is missing is an error that names how to get it:
half of it would look like real time and miss deadlines when it matters.

Stop cleanly at SIGINT and SIGTERM.
"""

from __future__ import annotations

import ctypes
import gc
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from queue import Empty, SimpleQueue
from threading import Lock
from types import FrameType

from llfsm.runtime.engine.errors import OptionError, RealtimeError

_MCL_CURRENT_AND_FUTURE = 3

_lock = Lock()
_runs = 0  # in real time, each in its own thread
_of_process = ExitStack()  # undoes what they share


@contextmanager
def in_real_time(priority: int, cpu: int | None) -> Iterator[None]:
    """Give the calling thread SCHED_FIFO at `priority`, 1 to 99, and its process locked memory.

    With `cpu`, the thread runs on that core alone. Garbage is collected by `collect_if_due` only.
    Threads and processes that are started meanwhile have an ordinary priority. At the end all is as
    before, but for what another thread still needs in real time. Raise `RealtimeError`, and leave
    all as before, if a right is missing.
    """
    if not hasattr(os, "sched_setscheduler"):
        raise RealtimeError("only Linux has the priorities of SCHED_FIFO: leave out `realtime`")
    with ExitStack() as undo:
        if cpu is not None:
            _pin(cpu, undo)
        _prepare_process(undo)
        _schedule(priority, undo)
        yield


def check_real_time(priority: int | None, cpu: int | None) -> None:
    """Raise `OptionError` if an arrangement cannot have these options."""
    if priority is not None and not (_is_number(priority) and 1 <= priority <= 99):
        raise OptionError(f"realtime is {priority!r}; a priority is from 1 to 99")
    if cpu is not None and not (_is_number(cpu) and cpu >= 0):
        raise OptionError(f"cpu is {cpu!r}; a core is a number from 0")
    if cpu is not None and priority is None:
        raise OptionError("cpu is given without realtime")


def _is_number(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)  # True is no priority of 1


def collect_if_due() -> None:
    """Collect garbage as Python would have, had it not been held; call it between rounds."""
    for generation in (2, 1, 0):
        if gc.get_count()[generation] > gc.get_threshold()[generation] > 0:
            gc.collect(generation)
            return


def _pin(cpu: int, undo: ExitStack) -> None:
    before = os.sched_getaffinity(0)
    try:
        os.sched_setaffinity(0, {cpu})
    except (OSError, ValueError, OverflowError) as error:
        cores = ", ".join(map(str, sorted(before)))
        raise RealtimeError(f"core {cpu} cannot be used; this process has: {cores}") from error
    undo.callback(os.sched_setaffinity, 0, before)


def _prepare_process(undo: ExitStack) -> None:
    """Lock memory and hold garbage; the last of all runs in real time undoes both."""

    def leave() -> None:
        global _runs
        with _lock:
            _runs -= 1
            if not _runs:
                _of_process.close()

    global _runs
    with _lock:
        if not _runs:
            _lock_memory(_of_process)
            _hold_garbage(_of_process)
        _runs += 1
    undo.callback(leave)


def _lock_memory(undo: ExitStack) -> None:
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.mlockall(_MCL_CURRENT_AND_FUTURE):
        reason = os.strerror(ctypes.get_errno())
        import resource  # which Windows lacks

        limit, _ = resource.getrlimit(resource.RLIMIT_MEMLOCK)
        raise RealtimeError(
            f"memory cannot be locked ({reason}; the limit is {limit >> 10} kB): "
            f"{_how_to_get('memlock unlimited', 'IPC_LOCK')}"
        )
    undo.callback(libc.munlockall)


def _how_to_get(limit: str, capability: str) -> str:
    python = os.path.realpath(sys.executable)  # a link to it, as in a venv, can have none
    return (
        f"put `@realtime - {limit}` into /etc/security/limits.conf, or run "
        f"`setcap cap_ipc_lock,cap_sys_nice+ep {python}`; in a container, allow {capability}"
    )


def _schedule(priority: int, undo: ExitStack) -> None:
    policy, parameter = os.sched_getscheduler(0), os.sched_getparam(0)

    def restore() -> None:
        """Give the priority back; only who may raise it may also clear the flag for children."""
        try:
            os.sched_setscheduler(0, policy, parameter)
        except PermissionError:
            with suppress(PermissionError):
                os.sched_setscheduler(0, policy | os.SCHED_RESET_ON_FORK, parameter)

    fifo = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
    try:
        os.sched_setscheduler(0, fifo, os.sched_param(priority))
    except OSError as error:
        raise RealtimeError(
            f"the priority {priority} of SCHED_FIFO was refused ({error.strerror}): "
            f"{_how_to_get(f'rtprio {priority}', 'SYS_NICE')}"
        ) from error
    undo.callback(restore)


def _hold_garbage(undo: ExitStack) -> None:
    if gc.isenabled():
        undo.callback(gc.enable)
    gc.collect()
    gc.freeze()  # what is there already need not be looked at in each collection
    undo.callback(gc.unfreeze)
    gc.disable()


_SIGNALS = (signal.SIGINT, signal.SIGTERM)
_LOOK_S = 0.2


class StopRequest:
    """A request to stop: an event that one thread waits for, and a signal's handler may set.

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
        """Return True if a stop was asked for."""
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
