"""Processes of ours that belong together: started, watched and ended as one."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Mapping, Sequence
from typing import NamedTuple, Self

from llfsm.errors import LlfsmError

__all__ = ["ProcessDiedError", "Processes", "Standing"]

_PATIENCE_S = 5.0  # from SIGTERM to SIGKILL
_PAUSE_S = 1.0  # from an end to the next start
_EARLY_S = 5.0  # what fails so soon would fail again


class ProcessDiedError(LlfsmError):
    """A process has ended that should not have; the text ends with its last lines."""


class Standing(NamedTuple):
    """How a process is."""

    name: str
    pid: int | None
    """None until it is started again."""
    since_s: float
    said: str
    """The last line that it printed."""


class _Process:
    def __init__(self, name: str, arguments: Sequence[str], environment: Mapping[str, str]) -> None:
        self.name = name
        self.arguments = arguments
        self.started = time.monotonic()
        self.ended: float | None = None
        # A session of its own, so that a Ctrl-C at the terminal reaches only the supervisor;
        # the pipe to its input tells the process if the supervisor is killed.
        self.popen = subprocess.Popen(
            [sys.executable, "-m", "llfsm.cli", *arguments, "--until-eof"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            start_new_session=True,
            env=os.environ | environment,
        )
        self.said: deque[str] = deque(maxlen=10)
        self._reader = threading.Thread(target=self._read, name=f"output of {name}", daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self.popen.stdout is not None
        for line in self.popen.stdout:
            self.said.append(line.rstrip("\n"))

    def end(self) -> None:
        if self.popen.poll() is None:
            self.popen.terminate()
            try:
                self.popen.wait(_PATIENCE_S)
            except subprocess.TimeoutExpired:
                self.popen.kill()
                self.popen.wait()
        self._reader.join(_PATIENCE_S)
        for stream in (self.popen.stdin, self.popen.stdout):
            if stream is not None:
                stream.close()

    def has_ended(self) -> bool:
        if self.ended is None and self.popen.poll() is not None:
            self.ended = time.monotonic()
            self._reader.join(_PATIENCE_S)
        return self.ended is not None

    def has_failed_early(self) -> bool:
        assert self.ended is not None
        return self.popen.returncode > 0 and self.ended - self.started < _EARLY_S

    def death(self, then: str = "") -> str:
        """Return how it ended and what comes then; if it was by itself, with its last words."""
        code = self.popen.returncode
        if code < 0:
            return f"the {self.name} was killed by {signal.Signals(-code).name}{then}"
        return "\n    ".join([f"the {self.name} ended with {code}{then}", *self.said])

    def standing(self) -> Standing:
        pid = self.popen.pid if self.ended is None else None
        since = self.started if self.ended is None else self.ended
        last = self.said[-1] if self.said else ""
        return Standing(self.name, pid, time.monotonic() - since, last)


class Processes:
    """Run `llfsm` commands as processes; leaving the ``with`` block ends them, the last first.

    One that has ended ends all, or, if they are to `restart`, is started again after a pause,
    unless it failed within 5 s of its start. `environment` is added to theirs. `reports` holds what
    became of them, oldest first, to be taken out by whoever shows it.
    """

    def __init__(
        self, *, restart: bool = False, environment: Mapping[str, str] | None = None
    ) -> None:
        self.reports: deque[str] = deque()
        self._restart = restart
        self._environment = environment or {}
        self._all: list[_Process] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        while self._all:
            self._all.pop().end()

    def start(self, name: str, *arguments: str) -> None:
        """Start ``llfsm ARGUMENTS``; `name` is what it is called in reports."""
        self._all.append(_Process(name, arguments, self._environment))

    def standings(self) -> list[Standing]:
        """Return how they are, in the order of their start."""
        return [process.standing() for process in self._all]

    def check(self) -> None:
        """See to those that have ended; raise :class:`ProcessDiedError` if that ends all."""
        for place, process in enumerate(self._all):
            known = process.ended is not None
            if not process.has_ended():
                continue
            if not self._restart or process.has_failed_early():
                raise ProcessDiedError(process.death())
            assert process.ended is not None
            if not known:
                self.reports.append(process.death("; it starts again"))
            elif time.monotonic() - process.ended >= _PAUSE_S:
                process.end()
                self._all[place] = _Process(process.name, process.arguments, self._environment)

    def wait(self, seconds: float) -> None:
        """Let time pass, checking; a signal handler that raises cuts it short."""
        until = time.monotonic() + seconds
        while (left := until - time.monotonic()) > 0:
            self.check()
            time.sleep(min(left, 0.05))  # soon enough to tell that one has died
