"""A simulation in a process of its own: the machine's code may fail, hang or end it.

The process reads a JSON object per line and answers each with one. It ends with its input, also if
the machine's code does not return.
"""

from __future__ import annotations

import asyncio
import json
import os
import queue
import sys
import threading
from contextlib import suppress
from typing import Any

from llfsm.bridges.view.errors import RequestError
from llfsm.errors import LlfsmError

__all__ = ["SimulationProcess"]

_START_S = 30.0  # for the imports of the machine, too
_LONGEST = 1 << 24  # bytes of an answer


class SimulationProcess:
    """The process that simulates a machine, found as by `load_machine`, as it is there now.

    Code of the machine that runs for longer than `patience_s` is taken for an endless loop.
    """

    def __init__(self, process: asyncio.subprocess.Process, *, patience_s: float):
        self._process = process
        self._patience_s = patience_s
        self.has_ended = False
        self._turn = asyncio.Lock()

    @classmethod
    async def start(
        cls, found_by: list[str], *, patience_s: float = 5.0
    ) -> tuple[SimulationProcess, dict[str, Any]]:
        """Run the machine's text; return the process and its first answer."""
        process = await asyncio.create_subprocess_exec(
            *(sys.executable, "-m", "llfsm.bridges.edit.simulation_process", *found_by),
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
            limit=_LONGEST,
        )
        started = cls(process, patience_s=patience_s)
        try:
            return started, await started._answer(_START_S)
        except (RequestError, asyncio.CancelledError):
            await started.end()
            raise

    async def ask(self, what: str, *arguments: Any) -> dict[str, Any]:
        """Let the process do something and return its answer; `RequestError` says why it cannot."""
        async with self._turn:
            assert self._process.stdin is not None
            self._process.stdin.write(json.dumps([what, *arguments]).encode() + b"\n")
            return await self._answer(self._patience_s)

    async def end(self) -> None:
        """Kill the process, and wait until it has gone."""
        self._kill()
        async with self._turn:
            assert self._process.stdin is not None
            assert self._process.stdout is not None
            self._process.stdin.close()
            await self._process.stdout.read()
            await self._process.wait()

    def _kill(self) -> None:
        self.has_ended = True
        with suppress(ProcessLookupError):
            self._process.kill()

    async def _answer(self, patience_s: float) -> dict[str, Any]:
        assert self._process.stdout is not None
        try:
            # `wait_for` of Python 3.11 may return an answer and forget that it was cancelled.
            async with asyncio.timeout(patience_s):
                line = await self._process.stdout.readline()
        except TimeoutError:
            self._kill()
            raise RequestError(
                f"the machine's code does not return for {patience_s:g} s; simulation ended"
            ) from None
        except BaseException:  # an answer that nobody takes would be taken for the next one
            self._kill()
            raise
        if not line:
            self._kill()
            raise RequestError("the machine's code has ended its process; simulation ended")
        answer: dict[str, Any] = json.loads(line)
        if "problem" in answer:
            raise RequestError(answer["problem"])
        return answer


def _lines() -> queue.SimpleQueue[bytes]:
    """Return the lines of the input as they come; with its end the process ends."""
    lines: queue.SimpleQueue[bytes] = queue.SimpleQueue()

    def read() -> None:
        for line in sys.stdin.buffer:
            lines.put(line)
        os._exit(0)

    threading.Thread(target=read, daemon=True).start()
    return lines


def _main() -> None:
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what the machine prints is no answer
    lines = _lines()

    def answer(content: dict[str, Any]) -> None:
        answers.write(json.dumps(content).encode() + b"\n")
        answers.flush()

    try:
        from .simulated_machine import SimulatedMachine  # here, when what is printed goes elsewhere

        machine = SimulatedMachine(sys.argv[1:])
        answer({"sensors": machine.sensors(), "simulation": machine.describe()})
    except (LlfsmError, OSError) as error:
        answer({"problem": str(error)})
        return
    while True:
        what, *arguments = json.loads(lines.get())
        try:
            if what == "save":
                answer({"text": machine.test_text()})
            else:
                getattr(machine, what)(*arguments)
                answer({"simulation": machine.describe()})
        except LlfsmError as error:
            answer({"problem": str(error)})


if __name__ == "__main__":
    _main()
