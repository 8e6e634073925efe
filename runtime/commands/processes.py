"""Processes of ours that belong together: started, watched and ended as one."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Sequence
from typing import Self

from ..errors import ProcessDiedError

__all__ = ["Processes"]

_PATIENCE_S = 5.0  # from SIGTERM to SIGKILL


class _Process:
    def __init__(self, name: str, arguments: Sequence[str], lines: deque[str]) -> None:
        self.name = name
        # A session of its own, so that a Ctrl-C at the terminal reaches only the supervisor;
        # the pipe to its input tells the process if the supervisor is killed.
        self.popen = subprocess.Popen(
            [sys.executable, "-m", "llfsm.runtime", *arguments, "--until-eof"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            start_new_session=True,
        )
        self._lines = lines
        self.said: deque[str] = deque(maxlen=10)
        self._reader = threading.Thread(target=self._read, name=f"output of {name}", daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self.popen.stdout is not None
        for line in self.popen.stdout:
            self.said.append(line.rstrip("\n"))
            self._lines.append(f"{self.name}: {self.said[-1]}")

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

    def death(self) -> ProcessDiedError:
        code = self.popen.returncode
        how = f"was killed by {signal.Signals(-code).name}" if code < 0 else f"ended with {code}"
        self._reader.join(_PATIENCE_S)
        return ProcessDiedError("\n    ".join([f"the {self.name} {how}", *self.said]))


class Processes:
    """Run `llfsm` commands as processes; leaving the ``with`` block ends them, the last first.

    ``lines`` holds what they print, oldest first, to be taken out by whoever shows it.
    """

    def __init__(self) -> None:
        self.lines: deque[str] = deque(maxlen=1000)
        self._running: list[_Process] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        while self._running:
            self._running.pop().end()

    def start(self, name: str, *arguments: str) -> None:
        """Start ``llfsm ARGUMENTS``; `name` is what it is called in reports."""
        self._running.append(_Process(name, arguments, self.lines))

    def check(self) -> None:
        """Raise :class:`ProcessDiedError` if one has ended."""
        for process in self._running:
            if process.popen.poll() is not None:
                raise process.death()

    def wait(self, seconds: float) -> None:
        """Let time pass, checking; a signal handler that raises cuts it short."""
        until = time.monotonic() + seconds
        while (left := until - time.monotonic()) > 0:
            self.check()
            time.sleep(min(left, 0.05))
