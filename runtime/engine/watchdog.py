"""A watchdog: where code of a machine hangs, seen from another thread.

It looks at the stack of the thread that runs the arrangement, so that a ringlet costs nothing more.
A section hangs if the same call is still running after the limit. Python code, sleeps and C code
that releases the GIL are seen. C code that holds it stops this thread, too, as a signal that stops
the process does: all that can be done is to log afterwards that nothing ran.
"""

from __future__ import annotations

import sys
import threading
import time
from types import FrameType
from typing import NamedTuple

from llfsm.runtime.engine.kernel import Kernel
from llfsm.runtime.engine.ringlet import Running, defined_ringlet, running
from llfsm.runtime.engine.seat import RUNTIME, Seat
from llfsm.runtime.log import logger

_BEAT_S = 0.25  # between two statuses of a machine that hangs
_PATIENCE_S = 0.5  # after a signal, until a call that still runs is reported
_STANDSTILL_S = 0.5  # by which the watchdog itself is later than on a machine that is busy
_TURNS = (defined_ringlet.__code__, Kernel.round.__code__, Kernel.rest.__code__)


class RunningCall(NamedTuple):
    """A call of a machine's code that is running in a ringlet."""

    frame: FrameType
    """The ringlet's, or that of the rounds in which its twin runs.

    While it is referenced, no other ringlet or call of rounds has the same object.
    """
    step: int
    """Where the ringlet is, or the number of its twin's call, which no other one has."""
    seat: Seat
    where: str
    """Machine, state and section, file and line."""

    def is_same(self, other: RunningCall | None) -> bool:
        """Check that the other is the same call, seen at another time."""
        return other is not None and self.frame is other.frame and self.step == other.step


def running_call(thread: int) -> RunningCall | None:
    """Return the call of a machine's code that a thread runs now, the innermost one; else None."""
    frame = sys._current_frames().get(thread)
    inner: FrameType | None = None  # the last of the machine's own frames on the way out
    innermost = frame
    while frame is not None and frame.f_code not in _TURNS:
        if not frame.f_code.co_filename.startswith(RUNTIME):
            inner = frame
        frame = frame.f_back
    if frame is None or inner is None or innermost is None:
        return None
    found = _ringlet_in(frame)
    if found is None:
        return None
    seat, (state, code, step) = found
    name, section = seat.place_of(state, code)
    where = f"machine {seat.name}, state {name}, {section} ({_line(inner)})"
    if innermost is not inner and not innermost.f_code.co_filename.startswith(RUNTIME):
        where += f", at {_line(innermost)}"
    return RunningCall(frame, step, seat, where)


def _ringlet_in(frame: FrameType) -> tuple[Seat, Running] | None:
    """Find the code that a ringlet runs: that of the frame, or its twin in a round of it."""
    local = frame.f_locals
    if frame.f_code is not defined_ringlet.__code__:
        kernel: Kernel = local["self"]
        seats = ((seat, running(seat)) for seat in tuple(kernel.roster))
        return next(((seat, now) for seat, now in seats if now is not None), None)
    seat, state, code = local.get("seat"), local.get("state"), local.get("code")
    return None if seat is None or state is None else (seat, (state, code, frame.f_lasti))


def _line(frame: FrameType) -> str:
    return f"{frame.f_code.co_filename}:{frame.f_lineno}"


class Watchdog:
    """Report code of machines that runs longer than `limit_s`, and post their safe values.

    It watches the thread that makes it, from `start` to `stop`.
    """

    def __init__(self, kernel: Kernel, limit_s: float):
        self._kernel = kernel
        self._limit_s = limit_s
        self._watched = threading.get_ident()
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="watchdog", daemon=True)

    def start(self) -> None:
        """Begin to watch."""
        self._thread.start()

    def stop(self) -> None:
        """Watch no more."""
        self._over.set()
        self._thread.join()

    def _watch(self) -> None:
        latest: RunningCall | None = None
        since_s = beat_s = 0.0
        hangs = False
        pause_s = min(self._limit_s / 4, 0.05)
        over = False
        while not over:
            slept_s = time.monotonic()
            due_s = slept_s + pause_s
            if latest is not None and not hangs:
                due_s = min(due_s, since_s + self._limit_s)
            over = self._over.wait(due_s - slept_s)
            now_s = time.monotonic()
            call = None if over else running_call(self._watched)
            if now_s - due_s > self._limit_s + _STANDSTILL_S:
                report_standstill(call, now_s - due_s)
            if call is None or not call.is_same(latest):
                if hangs and latest is not None:
                    logger().error("%s has returned after %.3g s", latest.where, now_s - since_s)
                    latest.seat.hang = ""
                latest, since_s, hangs = call, now_s, False
                continue
            if now_s - since_s < self._limit_s:
                continue
            if not hangs:
                hangs, beat_s = True, 0.0
                report_hang(self._kernel, call, now_s - since_s)
            if self._kernel.attendant is not None and now_s - beat_s >= _BEAT_S:
                beat_s = now_s
                self._kernel.attendant.publish_hang(call.seat.name)


def report_hang(kernel: Kernel, call: RunningCall, seconds: float) -> None:
    """Post a machine's safe values and log where it hangs; not by way of a journal.

    A journal keeps what machines do by themselves, and this is not. The log comes last: what hangs
    may hold its lock.
    """
    seat = call.seat
    seat.hang = call.where
    board = kernel.environment.whiteboard
    if board is not None:
        seat.post_safe("at_failure", board)
    logger().error("%s has been running for %.3g s", call.where, seconds)


def report_standstill(call: RunningCall | None, seconds: float) -> None:
    """Log that no thread of this process ran; `call` is what the watched one runs since."""
    where = "" if call is None else f"; it goes on with {call.where}"
    logger().warning(
        "this process has not run for %.3g s, as C code held the interpreter's lock or a signal "
        "stopped it%s",
        seconds,
        where,
    )


def stop_by_signal(kernel: Kernel, cause: str) -> None:
    """Stop the arrangement that this thread runs; if code of a machine hangs, report where."""
    kernel.stop(cause)
    thread = threading.get_ident()
    before = running_call(thread)
    if before is None:
        return

    def look_again() -> None:
        call = running_call(thread)
        if call is not None and call.is_same(before):
            report_hang(kernel, call, _PATIENCE_S)
            logger().error("it cannot stop until that returns; a second signal interrupts it")

    timer = threading.Timer(_PATIENCE_S, look_again)
    timer.daemon = True
    timer.start()
