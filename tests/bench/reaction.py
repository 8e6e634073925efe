"""How soon a machine answers a message of another process, and what it costs to wait for one.

To compare with, two processes in C that wake each other and do nothing else.
"""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from measure import Sampler, answering, compiled

from llfsm.runtime import Actuator, Machine, Sensor, State
from llfsm.whiteboard import Slot, Whiteboard
from llfsm.whiteboard.messages.std_msgs import Int32

__all__ = ["Echo", "idle_percents", "samplers"]

ASK, ANSWER = Slot("ask", Int32), Slot("answer", Int32)
_PAUSE_S = 0.003  # so that the other side sleeps
_PATIENCE_S = 30.0
_IDLE_US = 10_000  # the default


class Echo(Machine):
    """Answer each message by the same."""

    asked = Sensor(ASK, default=Int32(0))
    answer = Actuator(ANSWER)
    answered: int = 0

    waiting = State()
    answering = State()

    @waiting.to(answering)
    def has_come(self) -> bool:
        return self.asked.data != self.answered

    @waiting.on_exit
    def _(self) -> None:
        self.answered = self.asked.data
        self.answer(self.asked)

    answering.to(waiting)


@contextmanager
def _running(board: str, machines: int) -> Iterator[tuple[int, Whiteboard]]:
    """Run so many machines by `llfsm run` as it is; yield its process id, and the whiteboard."""
    named = [f"echo{number}={__file__}:Echo" for number in range(machines)]
    llfsm = str(Path(sys.executable).with_name("llfsm"))
    with Whiteboard(board) as whiteboard:
        process = subprocess.Popen([llfsm, "run", *named, "-q", "--board", board])
        try:
            whiteboard.add_message(ASK, Int32(1))
            if not whiteboard[ANSWER].wait(after=machines - 1, timeout=_PATIENCE_S):
                raise TimeoutError("no machine answers")
            yield process.pid, whiteboard
        finally:
            process.terminate()
            process.wait()
            whiteboard.remove()


@contextmanager
def samplers(board: str) -> Iterator[tuple[Sampler, Sampler | None]]:
    """Yield what times a round trip to a machine, and one in C if there is a compiler."""
    with ExitStack() as stack:
        _, whiteboard = stack.enter_context(_running(board, 1))
        ask, answer = whiteboard[ASK], whiteboard[ANSWER]

        def ours() -> float:
            time.sleep(_PAUSE_S)
            before, begin_ns = answer.count, time.monotonic_ns()
            ask.add(Int32(before + 1))
            answered = answer.wait(after=before, timeout=_PATIENCE_S)
            taken_ns = time.monotonic_ns() - begin_ns
            if answered is None or answered.message != Int32(before + 1):
                raise TimeoutError("the machine does not answer")
            return taken_ns

        yield ours, stack.enter_context(_round_trips())


@contextmanager
def _round_trips() -> Iterator[Sampler | None]:
    with compiled("futex.c") as program:
        if program is None:
            yield None
            return
        with answering(program) as ask:

            def sample() -> float:
                time.sleep(_PAUSE_S)
                return float(ask())

            yield sample


def idle_percents(board: str, machines: int, seconds: float) -> tuple[list[float], list[float]]:
    """Return which part of a core machines take that wait for a message, and a loop that sleeps.

    The loop is in C and wakes as often; there is none without a compiler.
    """
    ours, its = [], []
    with _running(board, machines) as (pid, _), compiled("sleep.c") as program:
        begin_s, before_s = time.monotonic(), _cpu_s(pid)
        if program is None:
            time.sleep(seconds)
        else:
            sleeps = str(max(round(seconds * 1e6 / _IDLE_US), 1))
            with answering(program, "cost", str(_IDLE_US), sleeps, "0") as ask:
                its.append(float(ask()) / (_IDLE_US * 10))
        ours.append(100 * (_cpu_s(pid) - before_s) / (time.monotonic() - begin_s))
    return ours, its


def _cpu_s(pid: int) -> float:
    threads = Path(f"/proc/{pid}/task").glob("*/schedstat")
    return sum(int(thread.read_text().split()[0]) for thread in threads) / 1e9
