"""How soon a machine answers a message of another process, and what it costs to wait for one.

To compare with, two processes in C that wake each other and do nothing else.
"""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from measure import Sampler

from llfsm.runtime import Actuator, Machine, Sensor, State
from llfsm.whiteboard import Slot, Whiteboard
from llfsm.whiteboard.messages.std_msgs import Int32

__all__ = ["Echo", "idle_percent", "samplers"]

ASK, ANSWER = Slot("ask", Int32), Slot("answer", Int32)
_PAUSE_S = 0.003  # so that the other side sleeps
_PATIENCE_S = 30.0


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
    """Yield what times an answer of a machine, and a round trip in C if there is a compiler."""
    with ExitStack() as stack:
        _, whiteboard = stack.enter_context(_running(board, 1))
        ask, answer = whiteboard[ASK], whiteboard[ANSWER]

        def ours() -> float:
            time.sleep(_PAUSE_S)
            before = answer.count
            ask.add(Int32(before + 1))
            answered = answer.wait(after=before, timeout=_PATIENCE_S)
            asked = ask.sample()
            if answered is None or asked is None:
                raise TimeoutError("the machine does not answer")
            return answered.stamp_ns - asked.stamp_ns

        yield ours, stack.enter_context(_round_trips())


@contextmanager
def _round_trips() -> Iterator[Sampler | None]:
    compiler = shlex.split(os.environ.get("CC", "cc"))
    if not shutil.which(compiler[0]):
        yield None
        return
    with TemporaryDirectory() as folder:
        program = str(Path(folder, "futex"))
        source = str(Path(__file__).with_name("futex.c"))
        subprocess.run([*compiler, "-std=c11", "-O2", source, "-o", program], check=True)
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
        with subprocess.Popen([program], text=True, **pipes) as process:
            asks, answers = process.stdin, process.stdout
            assert asks is not None
            assert answers is not None

            def sample() -> float:
                time.sleep(_PAUSE_S)
                asks.write("\n")
                asks.flush()
                return float(answers.readline())

            yield sample


def idle_percent(board: str, machines: int, seconds: float) -> float:
    """Return which part of a core machines take that wait for a message."""
    with _running(board, machines) as (pid, _):
        begin_s, before_s = time.monotonic(), _cpu_s(pid)
        time.sleep(seconds)
        return 100 * (_cpu_s(pid) - before_s) / (time.monotonic() - begin_s)


def _cpu_s(pid: int) -> float:
    threads = Path(f"/proc/{pid}/task").glob("*/schedstat")
    return sum(int(thread.read_text().split()[0]) for thread in threads) / 1e9
